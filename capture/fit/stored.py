"""Estimates of finished steps in files, so that a fit goes on where it was interrupted."""

import hashlib
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from capture.fit.focal import Focal
from capture.fit.footage import Estimate, Footage
from capture.fit.person import Person
from files.npz import read_npz
from files.whole import whole_file

ARRAYS = ("g", "bias", "mean", "root", "heading", "angles")
# raised whenever a step of the fit would answer otherwise: what an older one found is then not gone on from
METHOD = 3
FIELDS = (*ARRAYS, "offsets", "log_focal", "inputs")


def fingerprint(footage: Footage, *numbers: Array | float | str) -> str:
    """What a step was made from: the method, its points, a few rows of its masks, and what came before."""
    digest = hashlib.sha256(f"method {METHOD}".encode())
    for value in (footage.pixels, footage.sure, footage.masks[:, ::8, ::8], np.float64(footage.focal), *numbers):
        digest.update(np.ascontiguousarray(value).tobytes() if not isinstance(value, str) else value.encode())
    return digest.hexdigest()


def write_estimate(path: Path, estimate: Estimate, inputs: str) -> None:
    """Keep a finished step."""
    fields = {name: getattr(estimate, name) for name in ARRAYS}
    with whole_file(path) as file:
        np.savez(file, offsets=estimate.person.offsets, log_focal=estimate.log_focal, inputs=inputs, **fields)


def read_estimate(path: Path, person: Person, inputs: str) -> Estimate | None:
    """The finished step, if it is there and was made from the same."""
    fields = _stored(path, FIELDS, inputs)
    if fields is None:
        return None
    arrays = {name: fields[name] for name in ARRAYS}
    return Estimate(person.with_offsets(fields["offsets"]), log_focal=float(fields["log_focal"]), **arrays)


def write_focal(path: Path, focal: Focal, inputs: str) -> None:
    """Keep the focal length found from all videos."""
    with whole_file(path) as file:
        np.savez(file, shorter_sides=focal.shorter_sides, sigma=focal.sigma, inputs=inputs)


def read_focal(path: Path, inputs: str) -> Focal | None:
    """The focal length, if it was found and from the same."""
    fields = _stored(path, ("shorter_sides", "sigma", "inputs"), inputs)
    return None if fields is None else Focal(float(fields["shorter_sides"]), float(fields["sigma"]))


def _stored(path: Path, names: tuple[str, ...], inputs: str) -> dict[str, Array] | None:
    fields = read_npz(path, "a step of a fit", names) if path.is_file() else None
    return fields if fields and str(fields["inputs"]) == inputs else None
