"""The light of a video as a factor of what its part shows: the color network learns albedo (Eq. 2), light is fixed.

While a part learns, each section's albedo is lit at its posed normal, in the frame where the light stands still. The
finished person has no frame: it is shown under the *seen light*, the mean of S and H over the frames that saw a
normal, which is what the paper's appearance at the global direction means.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from torch import Tensor

from avatar.light import CaptureLight
from avatar.rotation import fibonacci_sphere
from avatar.skeleton import JOINTS, PARTS, skin_transforms
from capture.folder import Capture
from capture.light.frames import light_from_video
from command.errors import AssetError
from command.settings import settings_json

# numbers of a seen light: spherical harmonics to degree 4
HARMONICS = 25


def shown(
    albedo: Float[Tensor, "*n 3"], shading: Float[Tensor, "*n"], highlight: Float[Tensor, "*n"], gamma: float
) -> Float[Tensor, "*n 3"]:
    """CaptureLight.shown in torch, with a finite gradient for black."""
    if gamma == 1.0:
        return (albedo * shading[..., None] + highlight[..., None]).clamp(0, 1)
    linear = albedo.clamp_min(1e-6) ** gamma * shading[..., None] + highlight[..., None]
    return linear.clamp(1e-8, 1) ** (1 / gamma)


@dataclass(frozen=True)
class VideoLight:
    """The light of one video, and how its frames lie in it."""

    light: CaptureLight
    # from where the part's rays lie (world; canonical for the head) to where the light stands still
    light_from_ray: Float[Array, "frames 3 3"]

    def tensors(self, device: torch.device) -> "LightTensors":
        put = lambda array: torch.as_tensor(np.asarray(array), dtype=torch.float32, device=device)
        # lamps as each frame's rays see them
        lamps = np.einsum("fji,lj->fli", self.light_from_ray, self.light.directions)
        return LightTensors(self.light, put(lamps), put(self.light.strengths), put(self.light.shares))


class LightTensors(NamedTuple):
    """A video's light on the training device."""

    light: CaptureLight
    # towards each lamp, per frame, where the rays lie
    lamps: Float[Tensor, "frames lamps 3"]
    strengths: Float[Tensor, "lamps"]
    shares: Float[Tensor, "lamps"]

    def lit(
        self, albedo: Float[Tensor, "b k 3"], normals: Float[Tensor, "b k 3"], towards_eye: Float[Tensor, "b 3"],
        frame: Int[Tensor, "b"],
    ) -> Float[Tensor, "b k 3"]:  # fmt: skip
        """Display color of sections; normals and directions lie where the rays do."""
        lamps = self.lamps[frame]
        shading = self.light.ambient + (normals @ lamps.transpose(1, 2)).clamp_min(0) @ self.strengths
        highlight = torch.zeros_like(shading)
        if self.light.gloss > 0:
            half = torch.nn.functional.normalize(towards_eye[:, None] + lamps, dim=-1, eps=1e-9)
            lobes = (normals @ half.transpose(1, 2)).clamp_min(0) ** self.light.exponent
            highlight = self.light.gloss * (lobes @ self.shares)
        return shown(albedo, shading, highlight, self.light.gamma)


def video_light(capture: Capture, part: str, light: CaptureLight, canonical_from_head: Array) -> VideoLight:
    """A video's light as its part's rays meet it."""
    return VideoLight(light, light_from_video(capture, part, light.frame, canonical_from_head))


def world_light(capture: Capture, light: CaptureLight) -> CaptureLight:
    """The body video's light in the world of the poses: a camera on a tripod is turned by its own direction."""
    if light.frame == "world":
        return light
    camera_from_world = capture.videos["body"].cameras[0].camera_from_world[:3, :3]
    return light.turned(camera_from_world.T, "world")


def seen_light(capture: Capture, part: str, video: VideoLight) -> dict[str, Any]:
    """Mean S and H that a part's video saw at each canonical normal, frames weighted by how they face it, as run.json
    holds them.

    The part turns as its first bone does. Normals that no frame faces take the frames that face them least badly.
    """
    turns, of = video.light_from_ray, capture.videos[part]
    if of.axis_angle is not None and of.root is not None:
        joint = {"body": "pelvis", "hand_left": "left_wrist", "hand_right": "right_wrist"}[part]
        bone = JOINTS.index(joint)
        posed = [skin_transforms(a, capture.subject.joints, r)[bone, :3, :3] for a, r in zip(of.axis_angle, of.root)]
        turns = turns @ np.stack(posed)
    # towards the eye, along the optical axis
    axes = np.stack([camera.camera_from_world[2, :3] for camera in of.cameras])
    eyes = -np.einsum("fij,fj->fi", light_from_video(capture, part, video.light.frame), axes)
    normals = fibonacci_sphere(400)
    sums = np.zeros((3, len(normals)))
    for turn, eye in zip(turns, eyes, strict=True):
        n = normals @ turn.T
        weight = np.maximum(n @ eye, 0) + 1e-3
        highlight = video.light.highlight(n, np.broadcast_to(eye, n.shape))
        sums += weight * np.stack([np.ones(len(n)), video.light.shading(n), highlight])
    basis = harmonics(normals)
    fitted = np.linalg.lstsq(basis, (sums[1:] / sums[0]).T, rcond=None)[0]
    return {"shading": fitted[:, 0].tolist(), "highlight": fitted[:, 1].tolist(), "gamma": video.light.gamma}


def seen_lights_from_json(place: str, content: Any) -> tuple["SeenLight", ...]:
    """Seen lights by part as run.json holds them.

    Raises:
        AssetError: they are not such lights.
    """
    if not isinstance(content, dict) or set(content) != set(PARTS):
        raise AssetError(f"{place} should hold {', '.join(PARTS)}")
    found = []
    for part in PARTS:
        one = content[part]
        try:
            shading, highlight = (np.array(one[key], np.float64) for key in ("shading", "highlight"))
            gamma = float(one["gamma"])
        except (KeyError, TypeError, ValueError, OverflowError):
            raise AssetError(f"{place}: {part} should hold shading, highlight and gamma, is {one!r:.80}") from None
        fits = shading.shape == highlight.shape == (HARMONICS,)
        if not fits or not np.isfinite(np.r_[shading, highlight, gamma]).all() or not 1 <= gamma <= 4:
            raise AssetError(f"{place}: {part} should hold {HARMONICS} finite numbers each and a gamma from 1 to 4")
        found.append(SeenLight(torch.tensor(shading).float(), torch.tensor(highlight).float(), gamma))
    return tuple(found)


def light_facts(capture: Capture, lights: Mapping[str, VideoLight]) -> dict[str, Any]:
    """What run.json says of the lights: by video, in the world of the poses, and as seen."""
    return {
        "light": {part: settings_json(one.light) for part, one in lights.items()},
        "light_world": settings_json(world_light(capture, lights["body"].light)),
        # from the person towards the body's camera
        "light_camera": (-capture.videos["body"].cameras[0].camera_from_world[2, :3]).tolist(),
        "light_seen": {part: seen_light(capture, part, one) for part, one in lights.items()},
    }


class SeenLight(NamedTuple):
    """Mean S and H of a part's video at canonical normals, spherical harmonics to degree 4."""

    shading: Float[Tensor, "25"]
    highlight: Float[Tensor, "25"]
    gamma: float

    def shown(self, albedo: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Albedo as the part's video showed it on average."""
        shading, highlight = self.at(normals).unbind(1)
        return shown(albedo, shading, highlight, self.gamma)

    def at(self, normals: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2"]:
        """S (at least a hundredth) and H (at least 0) at unit canonical normals."""
        basis = harmonics(normals)
        shading, highlight = (basis @ numbers.to(basis.device) for numbers in (self.shading, self.highlight))
        return torch.stack([shading.clamp_min(0.01), highlight.clamp_min(0)], 1)


def harmonics(n: Any) -> Any:
    """Polynomials of a unit normal up to degree 4, 25 of them, torch or NumPy: the span of spherical harmonics."""
    x, y, z = n[:, 0], n[:, 1], n[:, 2]
    one = x * 0 + 1
    xx, yy, zz = x * x, y * y, z * z
    terms = [one, x, y, z, x * y, y * z, z * x, xx - yy, 3 * zz - 1,
             x * (xx - 3 * yy), y * (3 * xx - yy), z * (xx - yy), x * y * z, x * (5 * zz - 1), y * (5 * zz - 1),
             z * (5 * zz - 3), x * y * (xx - yy), xx * (xx - 3 * yy) - yy * (3 * xx - yy), z * x * (xx - 3 * yy),
             z * y * (3 * xx - yy), (xx - yy) * (7 * zz - 1), x * y * (7 * zz - 1), x * z * (7 * zz - 3),
             y * z * (7 * zz - 3), 35 * zz * zz - 30 * zz + 3]  # fmt: skip
    return torch.stack(terms, -1) if isinstance(n, Tensor) else np.stack(terms, -1)
