"""Posteriors as NetCDF in arviz's layout: `arviz.from_netcdf` opens them, whichever its version."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from irisjax.io.tables import replacing


def write_posterior(
    path: str | Path,
    groups: Mapping[str, Mapping[str, tuple[tuple[str, ...], np.ndarray]]],
    coordinates: Mapping[str, np.ndarray],
    attributes: Mapping[str, str],
) -> None:
    """Write a posterior whole or not at all, in groups of plain datasets, as xarray writes them.

    `groups` such as `posterior` and `observed_data` hold arrays by name, each with the names of its
    axes. An axis without `coordinates` is counted from 0; all groups get the attributes.
    """
    import h5netcdf

    with replacing(path) as temporary, h5netcdf.File(temporary, "w") as file:
        for name, arrays in groups.items():
            group = file.create_group(name)
            group.attrs.update({"created_with": "irisjax", **attributes})
            for key, (axes, array) in arrays.items():
                for axis, size in zip(axes, np.shape(array), strict=True):
                    if axis not in group.dimensions:
                        group.dimensions[axis] = size
                        along = coordinates.get(axis, np.arange(size))
                        group.create_variable(axis, (axis,), data=along)
                group.create_variable(key, axes, data=np.asarray(array))
