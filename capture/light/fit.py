"""Ambient, lamps and highlight from pixels of the posed template: a person who turns shows what is light.

    minimise over light and albedo  sum_i rho(I_i^gamma - A_f S(n_i) - H(n_i, v_i) - sheen(n_i . v_i))

f is the template triangle that pixel i shows; its albedo A_f, one for all videos, is eliminated (variable projection,
Golub and Pereyra 1973); what is left, a few numbers, is solved by Gauss-Newton with Cauchy's weights. A sheen that
follows the eye is fitted beside them, or it would be taken for a lamp, and then left alone. The scale between light
and albedo is not observable: mean S over the pixels becomes 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.light import EXPONENT, STRONGEST, CaptureLight, Frame, lamps_of
from avatar.skeleton import PARTS
from capture.folder import Capture
from capture.light.frames import light_frame
from capture.light.pixels import LitPixels, lit_pixels

GAMMAS = (1.0, 1.4, 1.8, 2.2)
ROUNDS = 14
# added to the albedo's weight in a triangle's sums: keeps a triangle with one dark pixel finite
TINY = 1e-9
# Below this share of the residual that a light explains there is none; another lamp, another gamma, a light of each
# video's own have to explain as much of what is left.
CLEAR = 0.03
# a lamp this much weaker than the ambient light is none
FAINT = 0.04
# where lamps are tried first: about the camera's axes and the world's alike
DIRECTIONS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) / 3**0.5
# fewer pixels say nothing
LEAST = 1000
# robust residual of what is shown: the rounding to eight bits, below which no light can be seen
ROUNDING = 0.3 / 255
# largest highlight: display values of a lamp seen in glass
MIRROR = 10.0
# pixels a video for choosing, all of them for the last fit
FEW = 6_000


@dataclass(frozen=True)
class LightFit:
    """The lights of a capture's videos, and how well they explain it."""

    # by part; empty: none was found, and nothing is to be divided out
    lights: dict[str, CaptureLight]
    # robust residual in display values, of 255: of one color a triangle, and with the lights
    residual_without: float
    residual: float
    pixels: int

    @property
    def shared(self) -> bool:
        """Whether all videos stand in one light."""
        return len(set(self.lights.values())) <= 1


def light_line(fit: LightFit) -> str:
    """One line for people on what was found."""
    if fit.pixels < LEAST:
        return f"light: taken as even, {fit.pixels} pixels show the template well where {LEAST} are needed"
    if not fit.lights:
        return f"light: even, none to separate from the skin (a color a triangle is {fit.residual:.1f} of 255 off)"
    body = fit.lights["body"]
    lamps = " and ".join(
        "a lamp of {:.2f} from ({:.2f}, {:.2f}, {:.2f})".format(lamp.strength, *lamp.direction) for lamp in body.lamps
    )
    apart = "" if fit.shared else ", another in each video"
    return (
        f"light: ambient {body.ambient:.2f} and {lamps} ({body.frame}), highlight {body.gloss:.2f}, gamma "
        f"{body.gamma:g}{apart}; a color a triangle is {fit.residual_without:.1f} of 255 off without it, "
        f"{fit.residual:.1f} with"
    )


def fit_capture_light(capture: Capture, *, seed: int = 0) -> LightFit:
    """The light of a capture from its four videos, its poses and its template."""
    frame = light_frame(capture)
    return fit_light(lit_pixels(capture, frame, seed), frame)


def fit_light(pixels: LitPixels, frame: Frame = "camera") -> LightFit:
    """The light in which pixels were seen: one for all videos unless one each explains clearly more.

    First one lamp, then a second; display values or powers of them (gamma); each step only if the residual drops by
    CLEAR. Two lamps on opposite sides explain much where one explains nothing. Where neither does, and where fewer
    than LEAST pixels can be read, no light is found.
    """
    rng = np.random.default_rng(17)
    each = [rng.permutation(np.flatnonzero(pixels.video == index))[:FEW] for index in range(len(PARTS))]
    few = pixels.chosen(np.sort(np.concatenate(each)))
    together = np.zeros(len(PARTS), np.int64)
    if len(few.face) < LEAST:
        return LightFit({}, np.nan, np.nan, len(few.face))

    problems = {gamma: _Problem(few, together, gamma) for gamma in GAMMAS}
    gamma, best, left = _best_gamma(problems, {g: _with_lamp(one, UNLIT, 0.5) for g, one in problems.items()})
    without = problems[gamma].shown_residual(problems[gamma].solve([UNLIT]).lights)
    none = LightFit({}, 255 * without, 255 * without, len(few.face))
    clear = left < (1 - CLEAR) * without and (best.lights[0].strengths / best.lights[0].ambient).max(initial=0) > FAINT
    more, groups = _with_lamp(problems[gamma], best.lights[0], 0.3 * best.lights[0].ambient), together
    weakest = (more.lights[0].strengths / more.lights[0].ambient).min(initial=np.inf)
    if more.residual < (1 - CLEAR) * best.residual and weakest > FAINT:
        gamma, best, left = _best_gamma(problems, {g: one.solve(more.lights) for g, one in problems.items()})
        clear = clear or left < (1 - 2 * CLEAR) * without
    if not clear or without < ROUNDING:
        return none
    apart = _Problem(few, np.arange(len(PARTS)), gamma).solve(best.lights * len(PARTS), rounds=2 * ROUNDS)
    if apart.residual < (1 - CLEAR) * best.residual:
        best, groups = apart, np.arange(len(PARTS))

    whole = _Problem(pixels, groups, gamma)
    best = whole.solve(best.lights)
    unlit = whole.shown_residual(whole.solve([UNLIT] * len(best.lights)).lights)
    left = whole.shown_residual(best.lights)
    if not left < (1 - CLEAR) * unlit:
        # what a few pixels said does not hold for all
        return none
    scale = float(whole.factors(best.lights)[0].mean())
    if not max(one.brightest for one in best.lights) < STRONGEST * scale:
        # nearly nothing of what is seen stands in it
        return none
    lights = [_light_of(one, gamma, frame).scaled(1 / scale) for one in best.lights]
    per_part = {part: lights[groups[index]] for index, part in enumerate(PARTS)}
    return LightFit(per_part, 255 * unlit, 255 * left, len(pixels.face))


@dataclass(frozen=True)
class _Parameters:
    ambient: float
    # directions times strengths
    lamps: Float[Array, "lamps 3"]
    gloss: float = 0.0
    # that follows the eye: round the middle, at the rim
    sheen: tuple[float, float] = (0.0, 0.0)

    @property
    def strengths(self) -> Float[Array, "lamps"]:
        return np.linalg.norm(self.lamps, axis=1)

    @property
    def brightest(self) -> float:
        """S of a surface that faced all lamps, no less than that of any."""
        return self.ambient + float(self.strengths.sum())

    def vector(self) -> Float[Array, "p"]:
        return np.r_[self.ambient, self.lamps.ravel(), self.gloss, self.sheen]

    def moved(self, step: Float[Array, "p"]) -> "_Parameters":
        """Ambient light stays above 0, the highlight at or above it and no more than a mirror's."""
        ambient = max(self.ambient + float(step[0]), 0.1 * self.ambient)
        gloss, middle, rim = np.r_[self.gloss, self.sheen] + step[-3:]
        lamps = self.lamps + step[1:-3].reshape(-1, 3)
        return _Parameters(ambient, lamps, float(np.clip(gloss, 0, MIRROR)), (float(middle), float(rim)))

    def scaled(self, factor: float) -> "_Parameters":
        """S times a factor."""
        return replace(self, ambient=self.ambient * factor, lamps=self.lamps * factor)


UNLIT = _Parameters(1.0, np.zeros((0, 3)))


@dataclass(frozen=True)
class _Solved:
    lights: list[_Parameters]
    # robust root mean square of what is shown less what is seen, display values
    residual: float


class _Problem:
    """Pixels in a space of gamma, in groups that share a light; `group` is that of each video."""

    def __init__(self, pixels: LitPixels, group: Int[Array, "videos"], gamma: float):
        self.group, self.gamma = group[pixels.video], gamma
        self.faces, self.face = np.unique(pixels.face, return_inverse=True)
        self.normal, self.towards_eye, self.shown = pixels.normal, pixels.towards_eye, pixels.color
        facing = np.clip((pixels.normal * pixels.towards_eye).sum(1), 0, 1)
        self.sheens = np.stack([facing**EXPONENT, (1 - facing) ** 3], 1)
        self.linear = pixels.color**gamma
        # display values a step of the linear one is worth; dark pixels would count without end
        self.slope = np.clip(pixels.color, 0.05, 1) ** (1 - gamma) / gamma
        # (pixel, channel) by which residuals are judged: light on a black suit is not seen; some say as much as all
        bright = np.argwhere(pixels.color > np.median(pixels.color))
        bright = bright if len(bright) else np.argwhere(pixels.color >= 0)
        self.judged = tuple(bright[:: max(len(bright) // 60_000, 1)].T)

    def factors(self, lights: Sequence[_Parameters]) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
        """S of every pixel, and H with the sheen."""
        shading, highlight = np.empty(len(self.face)), np.empty(len(self.face))
        for index, one in enumerate(lights):
            own = slice(None) if len(lights) == 1 else np.flatnonzero(self.group == index)
            light = _light_of(one, self.gamma, "camera")
            shading[own] = light.shading(self.normal[own])
            highlight[own] = light.highlight(self.normal[own], self.towards_eye[own]) + self.sheens[own] @ one.sheen
        return shading, highlight

    def per_face(self, values: Float[Array, "n"]) -> Float[Array, "faces"]:
        return np.bincount(self.face, values, len(self.faces))

    def eliminated(self, lights: Sequence[_Parameters], weight: Float[Array, "n 3"]) -> "_Eliminated":
        """The best albedos of the triangles under these lights and weights, and what they leave."""
        shading, highlight = self.factors(lights)
        left = self.linear - highlight[:, None]
        squares, albedo = np.empty((len(self.faces), 3)), np.empty((len(self.faces), 3))
        for c in range(3):
            pull = weight[:, c] * shading
            squares[:, c] = self.per_face(pull * shading) + TINY
            albedo[:, c] = self.per_face(pull * left[:, c]) / squares[:, c]
        tint = albedo[self.face]
        return _Eliminated(shading, tint, squares, left - tint * shading[:, None])

    def weighed(self, difference: Float[Array, "n 3"]) -> tuple[Float[Array, "n 3"], float]:
        """Cauchy's weights of differences (to first order display values), and their robust deviation."""
        r = difference * self.slope
        spread = 1.4826 * max(float(np.median(np.abs(r[self.judged]))), 1e-4)
        return self.slope**2 / (1 + (r / (2.385 * spread)) ** 2), spread

    def shown_residual(self, lights: Sequence[_Parameters]) -> float:
        """Robust deviation of what is seen from what lights and the best albedos show: of display values
        themselves, not to first order as while it is solved, so that spaces of other gammas can be compared."""
        weight = self.slope**2
        for _ in range(6):
            at = self.eliminated(lights, weight)
            weight, _ = self.weighed(at.left)
        shown = np.maximum(self.linear - at.left, 0) ** (1 / self.gamma)
        return 1.4826 * float(np.median(np.abs(self.shown - shown)[self.judged]))

    def solve(self, lights: Sequence[_Parameters], rounds: int = ROUNDS) -> _Solved:
        """Gauss-Newton from these lights; the brightest is the unit, as albedos take up any other."""
        lights, weight = list(lights), self.slope**2
        # the weights settle first
        for _ in range(2):
            weight, residual = self.weighed(self.eliminated(lights, weight).left)
        best = _Solved(lights, residual)
        for _ in range(rounds):
            step = self.step(lights, self.eliminated(lights, weight), weight)
            lights = [one.moved(s) for one, s in zip(lights, step, strict=True)]
            unit = max(one.brightest for one in lights)
            lights = [one.scaled(1 / unit) for one in lights]
            weight, residual = self.weighed(self.eliminated(lights, weight).left)
            still = abs(best.residual - residual) < 1e-4 * best.residual
            if residual < best.residual:
                best = _Solved(lights, residual)
            if still:
                break
        return best

    def step(
        self, lights: Sequence[_Parameters], at: "_Eliminated", weight: Float[Array, "n 3"]
    ) -> list[Float[Array, "p"]]:
        """One Gauss-Newton step of every light, the albedos following."""
        width = len(lights[0].vector())
        size = width * len(lights)
        H, b = np.zeros((size, size)), np.zeros(size)
        slopes = [self.slopes(index, one) for index, one in enumerate(lights)]
        for c in range(3):
            w, tint = weight[:, c], at.albedo[:, c]
            pull = w * at.shading
            columns = np.zeros((size, len(self.face)))
            for index, (rows, dS, dH) in enumerate(slopes):
                for k in range(width):
                    columns[index * width + k, rows] = tint[rows] * dS[:, k] + dH[:, k]
            for column in columns:
                column -= (self.per_face(pull * column) / at.squares[:, c])[self.face] * at.shading
            H += (columns * w) @ columns.T
            b += columns @ (w * at.left[:, c])
        # all lights brighter and all albedos darker is no step, and black pixels ask for none
        damping = 1e-6 * np.trace(H) / size + 1e-12
        return list(np.linalg.solve(H + damping * np.eye(size), b).reshape(len(lights), width))

    def slopes(self, index: int, one: _Parameters) -> tuple[Array, Float[Array, "m p"], Float[Array, "m p"]]:
        """Rows of a light's pixels, and how S and H there change with its numbers (H's lamp is taken as standing)."""
        rows = np.flatnonzero(self.group == index)
        n = self.normal[rows]
        lit = (n @ one.lamps.T) > 0
        dS = np.zeros((len(rows), len(one.vector())))
        dS[:, 0] = 1
        for k in range(len(one.lamps)):
            dS[:, 1 + 3 * k : 4 + 3 * k] = n * lit[:, [k]]
        dH = np.zeros_like(dS)
        dH[:, -3] = _light_of(replace(one, gloss=1.0), 1.0, "camera").highlight(n, self.towards_eye[rows])
        dH[:, -2:] = self.sheens[rows]
        return rows, dS, dH


class _Eliminated(NamedTuple):
    """Pixels under lights, their albedos chosen best."""

    shading: Float[Array, "n"]  # S
    albedo: Float[Array, "n 3"]
    squares: Float[Array, "faces 3"]  # weighted sums of S^2
    # seen less shown, in the space of gamma
    left: Float[Array, "n 3"]


def _best_gamma(problems: dict[float, "_Problem"], found: dict[float, _Solved]) -> tuple[float, _Solved, float]:
    """The gamma whose light leaves least of what is shown, that light and what it leaves; 1 unless another does so
    clearly."""
    left = {gamma: problem.shown_residual(found[gamma].lights) for gamma, problem in problems.items()}
    gamma = min(left, key=lambda g: left[g] * (1 if g == 1 else 1 + CLEAR))
    return gamma, found[gamma], left[gamma]


def _with_lamp(problem: _Problem, one: _Parameters, strength: float) -> _Solved:
    """One more lamp: the best of a few round the person, each followed a few steps, then to its end."""
    starts = [replace(one, lamps=np.concatenate([one.lamps, strength * d[None]])) for d in DIRECTIONS]
    tried = [problem.solve([start], rounds=3) for start in starts]
    best = min(tried, key=lambda one: one.residual)
    return problem.solve(best.lights)


def _light_of(one: _Parameters, gamma: float, frame: Frame) -> CaptureLight:
    there = one.strengths > 1e-9
    lamps = lamps_of(one.lamps[there], one.strengths[there])
    return CaptureLight(one.ambient, lamps, gloss=one.gloss, gamma=gamma, frame=frame)
