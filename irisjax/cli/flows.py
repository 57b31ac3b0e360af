"""Trained flows, kept in a folder; they are trained when they are first needed."""

from pathlib import Path
from typing import Any

import irisjax as ij
from irisjax.cli import options as opt
from irisjax.cli.files import check_is_folder
from irisjax.infer.amortised import flow_name, read_flow, save_flow, train_flow
from irisjax.io.tables import replacing
from irisjax.numerics.streams import key_of


def flow_for(problem: ij.Problem, folder: Path, seed: int, each: Any) -> Path:
    """Return the file of a problem's flow, and train one if there is none."""
    check_is_folder(folder)
    path = folder / f"{flow_name(problem)}.flow"
    if path.exists():
        read_flow(path, problem)
        return path
    opt.notice(f"training a flow for these bands and this model, some minutes; kept in {folder}")
    flow = train_flow(problem, each=each, key=key_of(seed))
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        save_flow(temporary, flow)
    return path
