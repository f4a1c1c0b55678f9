"""What a phone does to a picture: exposure that rolls a little, the sensor's noise."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from synth.raw.movement import EMPTY, ENTERING, Wander

# deviation of brightness and of red and blue over time, and how much darker it is once a person stands there
ROLL, TINT, DARKER = 0.012, 0.004, 0.03
# variance of a shown value v: READ + SHOT v
READ, SHOT = 1.2, 0.025


@dataclass(frozen=True)
class Phone:
    """Gains of every frame, and a sensor."""

    gain: Float[Array, "frames 3"]
    noise: float  # factor on the sensor's deviation
    seed: int

    def shoot(self, frame: int, light: Float[Array, "height width 3"]) -> UInt8[Array, "height width 3"]:
        shown = np.clip(light * self.gain[frame].astype(np.float32), 0, 255)
        if self.noise:
            rng = np.random.default_rng([self.seed, frame, 51])
            deviation = self.noise * np.sqrt(READ + SHOT * shown)
            shown += deviation * rng.standard_normal(shown.shape, np.float32)
        return np.clip(np.round(shown), 0, 255).astype(np.uint8)


def phone_of(times: Float[Array, "frames"], exposure: float, noise: float, seed: list[int]) -> Phone:
    """A phone whose exposure rolls by `exposure` (1: as phones do with it locked, 0: not at all)."""
    wander = Wander([*seed, 50], times)
    entered = np.clip((times - EMPTY - 0.3) / ENTERING, 0, 1)
    brightness = ROLL * wander.draw() - DARKER * entered
    tint = TINT * wander.draw(2)
    gain = 1 + exposure * np.stack([brightness + tint[:, 0], brightness, brightness + tint[:, 1]], 1)
    return Phone(gain, noise, int(np.random.default_rng([*seed, 52]).integers(2**31)))
