"""Sound to the shapes of a mouth: made vowels and hisses are what they are, silence is silence."""

import struct
import wave

import numpy as np
import pytest

from avatar.face import SHAPES
from files.sound import Sound, read_wav
from player.face.speech import MOST_JAW, VISEMES, VOWELS, Speech, classified, features, mouth_shapes

RATE = 16_000
JAW = SHAPES.index("jawOpen")


def vowel(f1, f2, f3=2500, pitch=120, seconds=0.3):
    """Pulses through resonances: an all-pole filter in the frequency domain."""
    pulses = np.zeros(int(seconds * RATE))
    pulses[:: RATE // pitch] = 1
    z = np.exp(2j * np.pi * np.fft.rfftfreq(len(pulses)))
    spectrum = np.fft.rfft(pulses)
    for f, wide in ((0.0, 100), (f1, 80), (f2, 100), (f3, 140), (3500, 200)):
        pole = np.exp((-np.pi * wide + 2j * np.pi * f) / RATE)
        spectrum /= (1 - pole / z) * (1 - np.conj(pole) / z)
    out = np.fft.irfft(spectrum, len(pulses))
    return 0.3 * out / np.abs(out).max()


def hiss(low, high, seconds=0.2, level=0.1):
    spectrum = np.fft.rfft(np.random.default_rng(0).normal(size=int(seconds * RATE)))
    hertz = np.fft.rfftfreq(int(seconds * RATE), 1 / RATE)
    out = np.fft.irfft(np.where((hertz > low) & (hertz < high), spectrum, 0))
    return level * out / np.abs(out).max()


def spoken(*parts):
    pause = np.zeros(RATE // 5)
    return Sound(
        np.concatenate([pause, *(piece for part in parts for piece in (part, pause))]).astype(np.float32), RATE
    )


def names(sound):
    return [list(VISEMES)[k] for k in classified(features(sound))[0].argmax(1)]


@pytest.mark.parametrize("size", [1.0, 1.18])
@pytest.mark.parametrize("name", VOWELS)
def test_a_vowel_is_heard_whatever_the_voice(name, size):
    f1, f2 = VOWELS[name]
    heard = names(spoken(vowel(size * f1, size * f2, size * 2500, int(120 * size**2))))[24:46]
    assert heard.count(name) >= 0.9 * len(heard)


def test_hisses_and_stops_are_told_apart_and_silence_is_none():
    assert names(spoken(vowel(730, 1150), hiss(5000, 8000)))[74:86].count("SS") == 12
    assert names(spoken(vowel(730, 1150), hiss(2000, 4500)))[74:86].count("CH") == 12
    closed = names(spoken(np.concatenate([vowel(730, 1150), np.zeros(RATE // 12), vowel(730, 1150)])))[52:56]
    assert closed == ["PP"] * 4
    for quiet in (np.zeros(RATE), 0.5 * np.ones(RATE), np.zeros(1)):
        assert not mouth_shapes(Sound(quiet.astype(np.float32), RATE)).any()
    sound = spoken(0.1 * vowel(730, 1150))
    assert names(sound._replace(samples=sound.samples + np.float32(0.05))) == names(sound)


def test_the_jaw_opens_in_30_ms_closes_in_80_and_never_wider_than_a_talk():
    speech = Speech(spoken(vowel(730, 1150)))
    jaw = np.array([speech.weights(t)[JAW] for t in np.arange(0, 0.7, 0.001)])
    assert 0.35 < jaw.max() <= MOST_JAW and np.abs(np.diff(jaw)).max() < 0.02
    rise, fall = (np.flatnonzero(jaw > share * jaw.max()) for share in (0.1, 0.9))
    assert fall[0] - rise[0] < 70 < rise[-1] - fall[-1]
    assert not speech.weights(-0.01).any() and not speech.weights(speech.seconds + 0.1).any()


@pytest.mark.parametrize("form", ["<i3", "<f4", "<f8"])
def test_24_bits_under_an_extensible_header_and_floats_are_read_and_of_a_file_cut_short_what_there_is(form, tmp_path):
    wanted, width = vowel(560, 1800), int(form[-1])
    tag, values = (3, wanted.astype(form)) if "f" in form else (1, np.round(wanted * 2**23).astype("<i4"))
    held = values.view(np.uint8).reshape(len(wanted), -1)[:, :width].tobytes()
    said = struct.pack("<HHIIHH", 0xFFFE, 1, RATE, RATE * width, width, 8 * width)
    said += struct.pack("<HHIH14x", 22, 8 * width, 4, tag)
    riff = b"RIFF\xff\xff\xff\xffWAVEodd \1\0\0\0..fmt " + struct.pack("<I", len(said)) + said
    (tmp_path / "a.wav").write_bytes(riff + b"data\xff\xff\xff\xff" + held[: -5 * width - 1])
    sound = read_wav(tmp_path / "a.wav")
    assert len(sound.samples) == len(wanted) - 6 and np.abs(sound.samples - wanted[:-6]).max() < 2e-7


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_pcm_of_any_width_is_the_same_sound(width, tmp_path):
    wanted = vowel(560, 1800)
    scale = 2 ** (8 * width - 1)
    whole = np.round(wanted * (scale - 1)).astype("<i8") + (128 if width == 1 else 0)
    both = np.repeat(whole, 2).view(np.uint8).reshape(-1, 8)[:, :width]
    with wave.open(str(tmp_path / "a.wav"), "wb") as file:
        file.setparams((2, width, RATE, 0, "NONE", ""))
        file.writeframes(both.tobytes())
    sound = read_wav(tmp_path / "a.wav")
    assert sound.rate == RATE and np.abs(sound.samples - wanted).max() < 1.1 / scale + 1e-6
