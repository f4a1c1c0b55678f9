"""Estimates of finished steps in files, so that a fit goes on where it was interrupted."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from capture.fit.footage import Estimate, Footage
from capture.fit.person import Person
from files.npz import read_npz
from files.whole import whole_file

ARRAYS = ("g", "bias", "mean", "root", "heading", "angles")
# raised whenever a step of the fit would answer otherwise: what an older one found is then not gone on from
METHOD = 4
FIELDS = (*ARRAYS, "offsets", "log_focal")


def fingerprint(footage: Footage, *numbers: Array | float | str) -> str:
    """What a step was made from: the method, its points, a few rows of its masks, and what came before."""
    digest = hashlib.sha256(f"method {METHOD}".encode())
    for value in (footage.pixels, footage.sure, footage.masks[:, ::8, ::8], np.float64(footage.focal), *numbers):
        digest.update(np.ascontiguousarray(value).tobytes() if not isinstance(value, str) else value.encode())
    return digest.hexdigest()


def estimate_fields(estimate: Estimate) -> dict[str, Any]:
    """What is kept of an estimate."""
    kept = {name: getattr(estimate, name) for name in (*ARRAYS, "log_focal")}
    return kept | {"offsets": estimate.person.offsets}


def estimate_of(fields: dict[str, Array], person: Person) -> Estimate:
    """The estimate that was kept."""
    arrays = {name: fields[name] for name in ARRAYS}
    return Estimate(person.with_offsets(fields["offsets"]), log_focal=float(fields["log_focal"]), **arrays)


def write_step(path: Path | None, fields: dict[str, Any], inputs: str) -> None:
    """Keep a finished step's fields; None: nowhere."""
    if path is not None:
        with whole_file(path) as file:
            np.savez(file, inputs=inputs, **fields)


def read_step(path: Path | None, names: tuple[str, ...], inputs: str) -> dict[str, Array] | None:
    """The fields of a finished step, if it is there and was made from the same."""
    fields = read_npz(path, "a step of a fit", (*names, "inputs")) if path is not None and path.is_file() else None
    return fields if fields and str(fields["inputs"]) == inputs else None
