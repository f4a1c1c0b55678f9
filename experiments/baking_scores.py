"""How near the bakes of experiments/baking.py come to their field and to true pictures, and what their frames cost.

Avatars are drawn in their own view mode with 2 x 2 samples a pixel, in the light of the videos where their files hold
it, as the field is, inside the cone of directions that was seen. True pictures are those of held-out poses, the whole
person and close-ups of head and hands; the field is compared in the same views at twice their size, for textures hold
more than the truth's pixels show. FLIP and SSIM over the region's rectangle, PSNR over the region itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from avatar.camera import Camera
from avatar.gltf.avatar_file import Avatar, read_avatar
from bake.measure import test_views
from bench.field.drawer import FILMED, Drawer
from bench.field.posed_field import averaged
from bench.ladder.machine import Quiet
from bench.ladder.rung_scores import compared, crop_of, median_interval
from bench.score.picture_scores import DILATION, VIEW_REGION, region_of
from capture.folder import read_capture_facts
from capture.held_out import SETS, read_held_out, some_poses
from command.progress import progress
from experiments.alternating import Times, alternate, here
from experiments.short_training import read_kept
from experiments.table_row import digest
from files.whole import write_json
from player.draw.drawing import BarePose
from player.gl.context import Context, open_context
from player.scene.renderer import Renderer

FORMAT = "selfscan-baking-scores"
REGIONS = ("total", "head", "hands")
# squared, a pixel; the truth is smoothed as well
SAMPLES = 2
# sides of the field's pictures, as a multiple of the truth's
ENLARGED = 2
# pixels a side of pictures where there is no truth
SIZE = 256
# pixels a side of the frames that are timed, and how many of a turn
FRAME_SIZE, FRAMES = (640, 640), 4

Picture = Float[np.ndarray, "height width 3"]


class Seen(NamedTuple):
    """A pose under a camera, for the true picture, and which pixels its region has there; None: all of the person's."""

    region: str
    pose: BarePose
    camera: Camera
    truth: Picture | None
    mask: Bool[np.ndarray, "height width"] | None


class Reference(NamedTuple):
    """A picture that avatars are compared with."""

    region: str
    pose: BarePose
    camera: Camera
    picture: Picture
    mask: Bool[np.ndarray, "height width"]

    @property
    def around(self) -> Bool[np.ndarray, "height width"]:
        """What is looked at: of a close-up its part and what its edge can reach."""
        if self.region == "total":
            return np.ones_like(self.mask)
        return binary_dilation(self.mask, np.ones((3, 3), bool), iterations=DILATION)


@dataclass(frozen=True)
class References:
    """The field of a run and, where there is a capture with truth, its true pictures."""

    run: Path
    seen: tuple[Seen, ...]
    # what the report says of them
    facts: dict[str, Any]

    @property
    def names(self) -> str:
        return "field and truth" if self.has_truth else "field"

    @property
    def has_truth(self) -> bool:
        return self.seen[0].truth is not None

    @property
    def bodies(self) -> list[Seen]:
        """The views of the whole person."""
        return [one for one in self.seen if one.region == "total"]

    @cached_property
    def pictures(self) -> dict[str, list[Reference]]:
        """By name: truth, field."""
        field = field_pictures(self.run, self.seen)
        if not self.has_truth:
            return {"field": field}
        truth = [
            Reference(one.region, one.pose, one.camera, one.truth, one.mask)
            for one in self.seen
            if one.truth is not None and one.mask is not None
        ]
        return {"truth": truth, "field": field}


def read_references(run: Path, capture: Path | None, poses: int) -> References:
    """What avatars are compared with: views of held-out poses, or where no truth is known of the bake's own."""
    facts: dict[str, Any] = {"poses": poses, "size": SIZE, "truth": None}
    if capture is not None and (capture / "truth" / SETS[0]).is_dir():
        views = some_poses(read_held_out(capture, SETS[0]), poses)
        regions = [VIEW_REGION[view.view] for view in views]
        seen = [
            Seen(
                name if name in REGIONS else "hands", (view.axis_angle, view.root), view.camera, view.image(),
                region_of(view, name)[0],
            )
            for view, name in zip(views, regions, strict=True)
        ]  # fmt: skip
        kept = ("subject", "light", "sheen")
        told = {key: value for key, value in read_capture_facts(capture).items() if key in kept}
        facts |= {"size": views[0].camera.size[0], "truth": told}
        # a part that is out of sight has nothing to be compared
        return References(run, tuple(one for one in seen if one.mask is not None and one.mask.any()), facts)
    joints = np.asarray(run_joints(run), np.float64)
    own = test_views(joints, SIZE)
    region = {"body": "total", "head": "head"}
    seen = [
        Seen(region.get(view.name.split()[1], "hands"), (view.axis_angle, view.root), view.camera, None, None)
        for view in own
    ]
    return References(run, tuple(seen), facts | {"poses": 2})


def run_joints(run: Path) -> Float[np.ndarray, "52 3"]:
    """The joints of the run's person in pose 0."""
    from train.run import read_run

    return np.asarray(read_run(run).subject.joints)


def field_pictures(run: Path, seen: Sequence[Seen]) -> list[Reference]:
    """The field in these views, enlarged."""
    drawer, found = Drawer(run, "cone"), []
    try:
        for one in progress(seen, "the field", len(seen)):
            camera = enlarged(one.camera)
            drawn = drawer.draw(*one.pose, camera, SAMPLES)
            mask = drawn.mask
            if one.mask is not None:
                mask = mask & one.mask.repeat(ENLARGED, 0).repeat(ENLARGED, 1)
            if mask.any():
                found.append(Reference(one.region, one.pose, camera, drawn.color, mask))
    finally:
        drawer.release()
    return found


def enlarged(camera: Camera) -> Camera:
    return camera.resized((ENLARGED * camera.size[0], ENLARGED * camera.size[1]))


def scored(folder: Path, references: References) -> dict[str, Any]:
    """The scores of the avatar in a folder, by reference and region, measured unless that has been done."""
    stamp = {
        "avatar": digest(folder / "avatar.glb"),
        "run": digest(references.run / "run.json"),
        **references.facts,
    }
    found = read_kept(folder / "scores.json", {"format": FORMAT, "stamp": stamp})
    if found is not None:
        return found
    avatar, context = read_avatar(folder / "avatar.glb"), open_context()
    try:
        scores = {name: avatar_scores(context, avatar, asked) for name, asked in references.pictures.items()}
    finally:
        context.release()
    result = {"format": FORMAT, "stamp": stamp, "scores": scores}
    write_json(folder / "scores.json", result)
    return result


def avatar_scores(context: Context, avatar: Avatar, asked: Sequence[Reference]) -> dict[str, Any]:
    """FLIP, PSNR over the region and SSIM of an avatar by region."""
    drawn = avatar_pictures(context, avatar, [(one.pose, one.camera) for one in asked])
    scores = {}
    for region in REGIONS:
        own = [(one, picture) for one, picture in zip(asked, drawn, strict=True) if one.region == region]
        if own:
            scores[region] = compared(
                [one.picture * one.around[..., None] for one, _ in own],
                [picture * one.around[..., None] for one, picture in own],
                [crop_of(one.mask) for one, _ in own],
                [one.mask for one, _ in own],
            )
    return scores


def avatar_pictures(context: Context, avatar: Avatar, views: Sequence[tuple[BarePose, Camera]]) -> list[Picture]:
    """An avatar in these views, which are of one size, in its own view mode."""
    size = views[0][1].size
    effects = replace(FILMED, view=avatar.default_view)
    renderer = Renderer(context, [avatar], (SAMPLES * size[0], SAMPLES * size[1]), effects=effects)
    try:
        pictures = []
        for pose, camera in views:
            pixels = renderer.draw([pose], camera).astype(np.float32) / 255
            pictures.append(averaged(pixels[..., :3], pixels[..., 3] > 0.5, SAMPLES).color)
        return pictures
    finally:
        renderer.release()


def frame_times(avatars: Mapping[str, Path], references: References, seconds: float) -> dict[str, Any]:
    """Milliseconds of a frame of each avatar in its own view mode, in turns, and as a multiple of the default's."""
    with open_context() as context:
        renderers: dict[str, Renderer] = {}
        for name, path in avatars.items():
            avatar = read_avatar(path)
            renderers[name] = Renderer(context, [avatar], FRAME_SIZE, view=avatar.default_view)
        frames = [(one.pose, one.camera.resized(FRAME_SIZE)) for one in references.bodies]
        return timed_in_turns(renderers, frames, seconds, "default")


def timed_in_turns(
    renderers: Mapping[str, Renderer], frames: Sequence[tuple[BarePose, Camera]], seconds: float, first: str
) -> dict[str, Any]:
    """Frames of all renderers, without reading back; `times_first` compares rounds with those of the renderer `first`.
    The renderers are released."""

    def drawing(renderer: Renderer):
        def draw(number: int) -> None:
            pose, camera = frames[number % len(frames)]
            assert renderer.target is not None
            renderer.draw_into(renderer.target, [pose], camera)
            renderer.context.gl.finish()

        return draw

    try:
        with Quiet() as quiet:
            programs = {name: here(drawing(renderer), FRAMES) for name, renderer in renderers.items()}
            times = alternate(programs, seconds=seconds)
        any_one = renderers[first].context
        return {
            "rows": {name: frame_row(one, times[first]) for name, one in times.items()},
            "renderer": any_one.renderer,
            "size": list(FRAME_SIZE),
            "others_cpu_share": quiet.others,
        }
    finally:
        for renderer in renderers.values():
            renderer.release()


def frame_row(times: Times, first: Times) -> dict[str, Any]:
    """Milliseconds of a frame, and ratios to those of `first` in the same rounds, of the clock and of the processor."""
    row: dict[str, Any] = times.row()
    for kind, ratios in (("", times.rounds / first.rounds), ("cpu_", times.cpu_rounds / first.cpu_rounds)):
        row[f"{kind}times_first"] = round(float(np.median(ratios)), 3)
        row[f"{kind}times_first_interval"] = [round(edge, 3) for edge in median_interval(ratios)]
    return row
