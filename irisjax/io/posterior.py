"""Posteriors as NetCDF in arviz's layout: `arviz.from_netcdf` opens them, whichever its version."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from irisjax.io.tables import replacing


def write_posterior(
    path: str | Path,
    groups: Mapping[str, Mapping[str, np.ndarray]],
    attributes: Mapping[str, str],
    observed: Mapping[str, np.ndarray],
) -> None:
    """Write a posterior whole or not at all, in groups of plain datasets, as xarray writes them.

    `groups` such as `posterior` and `prior` hold arrays (chain, draw, …) by name, `observed` those
    of the group `observed_data`; all groups get the attributes.
    """
    import h5netcdf

    with replacing(path) as temporary, h5netcdf.File(temporary, "w") as file:
        for name, arrays in groups.items():
            _write_group(file.create_group(name), arrays, attributes, ("chain", "draw"))
        _write_group(file.create_group("observed_data"), observed, attributes, ())


def _write_group(
    group, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, str], sampled: tuple[str, ...]
) -> None:
    """Write arrays whose first axes are `sampled`, counted from 0; other axes are not shared."""
    group.attrs.update({"created_with": "irisjax", **attributes})
    for key, array in arrays.items():
        array = np.asarray(array)
        names = [*sampled, *(f"{key}_dim_{i}" for i in range(array.ndim - len(sampled)))]
        for axis, size in zip(names, array.shape, strict=True):
            if axis not in group.dimensions:
                group.dimensions[axis] = size
                if axis in sampled:
                    group.create_variable(axis, (axis,), data=np.arange(size))
        group.create_variable(key, tuple(names), data=array)
