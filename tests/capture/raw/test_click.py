"""Joints clicked by the person: the page and its server, and what the reader, the judge and the fit make of them."""

import json
import os
import threading
import time
from pathlib import Path
from queue import Queue
from urllib.error import HTTPError
from urllib.request import ProxyHandler, build_opener

import numpy as np
import pytest
from browser_page import browser_page
from filmed_figure import ABSENT, film

from capture.keypoints.read import read_keypoints
from capture.raw import click
from capture.raw.click import POINTS, answered, click_joints
from capture.raw.glance import glance
from capture.raw.judge import judge
from capture.raw.selection import select
from capture.raw.video_file import open_video
from command.progress import Progress
from command.stages import command
from selfscan import make
from selfscan.__main__ import main
from synth.raw import film as raw_film

TESTS = Path(__file__).parents[2]
PICTURES = {k: np.full((90, 120, 3), 8 * k, np.uint8) for k in range(3, 10)}


def served(draft):
    """The page's address, and what is found once it was answered."""
    said, found = Queue(), Queue()
    threading.Thread(target=lambda: found.put(answered(PICTURES, said.put, draft)), daemon=True).start()
    return said.get(timeout=600), found


@pytest.fixture
def page(tmp_path):
    return served(tmp_path / "body.clicks")


def ask(address, data=None):
    with build_opener(ProxyHandler({})).open(address, None if data is None else json.dumps(data).encode()) as answer:
        return answer.read()


def test_only_who_knows_its_name_gets_the_page_and_a_wrong_answer_is_named(page):
    address, found = page
    assert address.startswith("http://127.0.0.1:") and ask(f"{address}4.jpg").startswith(b"\xff\xd8")
    # nothing comes from elsewhere
    assert b"//" not in ask(address).replace(b"http://", b"//").split(b"<script")[0]
    for other in (address[:-2], f"{address}11.jpg", address.rsplit("/", 2)[0] + "/points"):
        with pytest.raises(HTTPError, match="404"):
            ask(other)
    rows = {str(k): [[1.5, 2.0]] * len(POINTS) for k in PICTURES}
    for wrong, said in (
        ([], "6 or more"), (dict(list(rows.items())[:5]), "6 or more"), (rows | {"77": []}, "3, 4, 5"),
        (rows | {"4": [None]}, "picture 4: expected 13 places"), (rows | {"4": ["x"] * 13}, "left_shoulder should be"),
    ):  # fmt: skip
        with pytest.raises(HTTPError, match="400") as refusal:
            ask(f"{address}points", wrong)
        assert said in refusal.value.read().decode()
    assert found.empty()
    ask(f"{address}points", rows | {"5": [None] * 12 + [[1e4, 3]]})
    clicked = found.get(timeout=600)
    assert (clicked[4] == [1.5, 2, 1]).all() and clicked[5][:12].sum() == 0
    np.testing.assert_allclose(clicked[5][12], [120, 3, 1])


def test_each_click_is_kept_and_the_page_begins_with_them(page, tmp_path):
    done = [[10.5, 20], "hidden", "pass"]
    ask(f"{page[0]}log", done)
    for wrong in ([[1]], ["other"], [[1, "x"]], {}, done * 100):
        with pytest.raises(HTTPError, match="400"):
            ask(f"{page[0]}log", wrong)
    again, _ = served(tmp_path / "body.clicks")
    assert f'"log": {json.dumps(done)}'.encode() in ask(again)


@pytest.mark.slow
def test_clicks_keys_and_undo_in_a_browser_give_the_places_that_were_clicked(page, tmp_path):
    address, found = page
    with browser_page(tmp_path) as tab:
        tab.size(1000, 600)
        tab.call("Page.navigate", url=address)
        here = "document.querySelector('#film image')?.getAttribute('href') === '{}.jpg'"
        press = "onkeydown(new KeyboardEvent('keydown', {{key: '{}'}}))"
        place = "new DOMPoint({}, 20).matrixTransform(film.getScreenCTM())"
        click_at = f"(p => film.dispatchEvent(new MouseEvent('click', {{{{clientX: p.x, clientY: p.y}}}})))({place})"
        for k in PICTURES:
            tab.wait(here.format(k))
            if k == 3:
                tab.ask(press.format("n"))
                continue
            for n in range(13):
                tab.ask(press.format(" ") if n == 2 else click_at.format(10 + n))
                if n == 5:
                    tab.ask(press.format("Backspace"))
                    tab.ask(click_at.format(90))
        # what was done is kept, whatever becomes of the page
        draft, end = tmp_path / "body.clicks", time.monotonic() + 600
        while len(json.loads(draft.read_text())) < 1 + 6 * 13 and time.monotonic() < end:
            time.sleep(0.05)
        assert json.loads(draft.read_text())[:1] == ["pass"] and json.loads(draft.read_text())[3] == "hidden"
        tab.screenshot(tmp_path / "page.png")
        tab.ask(press.format("Enter"))
        clicked = found.get(timeout=600)
        assert not tab.problems
    assert sorted(clicked) == [4, 5, 6, 7, 8, 9]
    expected = [[10 + n, 20, 1] for n in range(13)]
    expected[2], expected[5] = [0, 0, 0], [90, 20, 1]
    for rows in clicked.values():
        np.testing.assert_allclose(rows, expected, atol=0.3)  # a click is a whole pixel of the screen


def clicks(found, noise):
    """Stands for the person: clicks as `found` has it, `noise` pixels off, the first picture passed over."""
    rng = np.random.default_rng(0)

    def answer(pictures, _say, _draft):
        out = {}
        for k in sorted(pictures)[1:]:
            rows = np.stack([found.seen(name)[k] for name in POINTS])
            rows[:, :2] += noise * rng.standard_normal((len(POINTS), 2))
            out[k] = np.where(rows[:, 2:] > 0.3, np.c_[rows[:, :2], np.ones(len(POINTS))], 0)
        return out

    return answer


@pytest.mark.slow
def test_the_clicked_frames_are_fitted_and_the_empty_room_is_known(tmp_path, monkeypatch):
    film(tmp_path, "body", "body")
    video, out = open_video(tmp_path / "body.mp4"), tmp_path / "clicked.json"
    truth = read_keypoints(tmp_path / "keypoints" / "body.json")
    monkeypatch.setattr(click, "answered", clicks(truth, 0.5))
    out.with_suffix(".clicks").write_text("[]")
    click_joints(video, out)
    assert not out.with_suffix(".clicks").exists()
    points = read_keypoints(out)
    seen = judge(glance(video, "body", points, Progress("looking", 9)))
    kept = select(seen, 60).frames
    assert len(kept) == 9 and not any(problem.fatal for problem in seen.problems)
    assert 10 < seen.empty.sum() < ABSENT and seen.empty[:10].all()
    known = [points.names.index(name) for name in POINTS]
    of_truth = np.stack([truth.seen(name)[kept, :2] for name in POINTS], 1)
    assert np.abs(points.pixels[kept][:, known] - of_truth).max() < 3


@pytest.mark.slow
def test_films_without_keypoints_and_a_person_who_clicks_end_in_an_avatar(tmp_path, monkeypatch, capfd):
    films, out = tmp_path / "me", tmp_path / "me.glb"
    size = ["--size", "160", "--seconds", "3"]
    # the body's film alone is clicked
    monkeypatch.setattr(raw_film, "PARTS", ("body",))
    assert main(["synth", "builtin", str(films), "--raw", "--keypoints", *size]) == 0
    truth = read_keypoints(films / "keypoints" / "body")
    (films / "keypoints").rename(tmp_path / "detector")
    # nobody sits there: refused in one line that says what to do
    words = ["make", str(films), "-o", str(out), "--stature", "1.753", "--minutes", "4"]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.getcwd(), str(TESTS)]))
    monkeypatch.setattr(make, "command", lambda *stage: command("tiny_commands", *stage[1:]))
    assert main(words) == 1
    assert "lets you click them" in capfd.readouterr().err
    monkeypatch.setattr(click, "answered", clicks(truth, 1.0))
    monkeypatch.setattr(make.sys.stdin, "isatty", lambda: True, raising=False)
    assert main(words) == 0
    facts = json.loads((tmp_path / "me.making" / "capture" / "capture.json").read_text())
    assert facts["filmed"] == ["body"] and len(facts["frame_numbers"]["body"]) >= 7 and out.stat().st_size > 1e5
