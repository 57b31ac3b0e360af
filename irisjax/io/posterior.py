"""Posteriors as NetCDF in arviz's layout: `arviz.from_netcdf` opens them, whichever its version."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np


def write_posterior(
    path: str | Path,
    groups: Mapping[str, Mapping[str, np.ndarray]],
    attributes: Mapping[str, str],
    observed: Mapping[str, np.ndarray],
) -> None:
    """Write groups (`posterior`, `prior`, …) of arrays (chain, draw, …) and `observed_data`, whole
    or not at all.

    Groups are plain datasets, so that neither InferenceData (arviz 0.x) nor DataTree (1.x) is
    needed.
    """
    import xarray as xr

    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        mode = "w"
        for name, arrays in (*groups.items(), ("observed_data", observed)):
            sampled = name != "observed_data"
            data = {}
            for key, array in arrays.items():
                own = [f"{key}_dim_{i}" for i in range(array.ndim - 2 * sampled)]
                data[key] = ([*(("chain", "draw") if sampled else ()), *own], array)
            dataset = xr.Dataset(data, attrs={"created_with": "irisjax", **attributes})
            for axis in ("chain", "draw"):
                if axis in dataset.sizes:
                    dataset = dataset.assign_coords({axis: np.arange(dataset.sizes[axis])})
            dataset.to_netcdf(temporary, group=name, mode=mode, engine="h5netcdf")
            mode = "a"
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def predictive_score(path: str | Path) -> tuple[float, float]:
    """Expected log predictive density of left-out values by PSIS-LOO [Vehtari et al. 2017], and its
    standard error.

    Compare it between processes fitted to the same data; differences of a few standard errors
    count.
    """
    import warnings

    with warnings.catch_warnings():
        # It announces its next version on import, and advises on single values; the error says
        # enough here.
        warnings.simplefilter("ignore")
        import arviz as az

        found = az.loo(az.from_netcdf(str(path)))
    # arviz 0.x and 1.x name it differently.
    return float(found.elpd_loo if hasattr(found, "elpd_loo") else found.elpd), float(found.se)
