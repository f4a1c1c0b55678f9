import numpy as np
from scipy.ndimage import gaussian_filter

from experiments.print_bands import bands


def test_bands_tell_what_a_blur_takes_and_what_is_not_the_print():
    rng = np.random.default_rng(0)
    true = gaussian_filter(rng.normal(size=(200, 200, 3)), (0.5, 0.5, 0))
    inside = np.zeros((200, 200), bool)
    inside[20:-20, 20:-20] = True
    same = bands([true], [true], [inside])
    assert set(same.amplitude.values()) == {1.0} == set(same.coherence.values())
    blurred = bands([true], [gaussian_filter(true, (1.2, 1.2, 0))], [inside])
    assert blurred.amplitude["4 mm"] < 0.2 < blurred.amplitude["8 mm"] < blurred.amplitude["16 mm"] < 1
    assert blurred.coherence["4 mm"] < blurred.coherence["8 mm"] < blurred.coherence["16 mm"]
    other = bands([true], [true[::-1]], [inside])
    assert other.amplitude["4 mm"] > 0.95 and abs(other.coherence["4 mm"]) < 0.1
    # a millimetre beside: the finest print suffers most
    shifted = bands([true], [np.roll(true, 1, axis=0)], [inside])
    assert shifted.coherence["4 mm"] < 0.35 < shifted.coherence["8 mm"] < shifted.coherence["16 mm"]
