"""The page of limits says what is found again, and a limit is found where it is."""

from functools import partial

import numpy as np
import pytest

from command.errors import AssetError
from experiments.limit_measures import Place
from experiments.limits import LIMITS, PAGE, STEP, Limit, edges, rows


@pytest.mark.parametrize("name", ["distance of an avatar from the origin", "frame rate of a clip"])
def test_a_limit_is_where_the_page_says(context, tmp_path, name):
    limit = next(limit for limit in LIMITS if limit.name == name)
    found = rows(limit, edges(limit, Place(tmp_path, context)))
    page = [[cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.read_text("utf-8").splitlines()]
    written = {row[1]: row for row in page if row[:1] == [found[0][0]]}
    assert len(written) == len(found)
    for _, side, value, error, bound, said in found:
        assert abs(np.log(float(value) / float(written[side][2]))) <= np.log(STEP)
        assert float(error) <= float(bound.split()[0]) and written[side][4] == bound
        # what is said, but for the number that was found
        assert said.split(", found")[0].split(", is")[0] in written[side][5]


def measured(ends: tuple[float, float], place: Place, value: float) -> float:
    if value < ends[0]:
        raise AssetError(f"{place.folder}/a/file.glb: x should be {ends[0]}, is {value:g}")
    return 0.1 if value <= ends[1] else 2.0


def test_bisection_finds_both_ends_and_says_what_comes_next(tmp_path):
    place = Place(tmp_path, None)
    limit = Limit("x", "m", "holds", partial(measured, (0.037, 4321.0)), 1.0, "m", usual=1, least=1e-9, most=1e9)
    found = edges(limit, place)
    for side, expected in (("smallest", 0.037), ("largest", 4321.0)):
        assert abs(np.log(found[side].value / expected)) <= np.log(STEP)
    assert str(found["smallest"].beyond).startswith("`file.glb: x should be 0.037, is 0.03")
    assert found["largest"].beyond == "nothing is said; 2 m"
    counted = Limit("n", "", "holds", partial(measured, (0, 4321.0)), 1.0, "m", usual=1, most=1e9, whole=True)
    assert edges(counted, place)["largest"].value == 4321
    assert edges(Limit("n", "", "", partial(measured, (0, 1e9)), 1.0, "m", 1, most=50), place)["largest"].beyond is None
