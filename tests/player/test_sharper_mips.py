"""On a software rasteriser the base colour is read one mip finer: nearer to the picture of many samples."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_avatar import tiny_avatar, tiny_level

from avatar.camera import Camera, look_at
from avatar.texture import sample_texture
from player.gl import texture
from player.gl.context import open_context
from player.scene.renderer import Renderer


@pytest.fixture(scope="module")
def board():
    """A square of 1 m that faces +z, its texture noise that changes over some four texels of 512."""
    noise = np.random.default_rng(0).uniform(0, 255, (128, 128, 1)).repeat(3, 2)
    grid = (np.arange(512) + 0.5) / 512
    uv = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    image = sample_texture(noise, uv).reshape(512, 512, 3).round().astype(np.uint8)
    corners = np.array([[-0.5, 0.5, 0], [-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0]], np.float32)
    flat = replace(
        tiny_level(vertices=4, faces=2, features=0),
        positions=corners,
        uv=np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        joints=np.zeros((4, 4), np.uint8),
        weights=np.array([[255, 0, 0, 0]] * 4, np.uint8),
        base_color=image,
    )
    return tiny_avatar(levels=(flat,), network=None, linear=None, default_view="off")


def drawn(avatar, size):
    eye = look_at(np.array([0.9, 0.3, 1.6]), np.zeros(3))  # aslant: a pixel covers 1.5 x 1.8 texels
    K = np.array([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]])
    with_context = open_context()
    try:
        renderer = Renderer(with_context, [avatar], (size, size), view="off")
        picture = renderer.draw([(np.zeros((52, 3)), np.zeros(3))], Camera(K, eye, (size, size)))[..., :3] / 255.0
        renderer.release()
        return picture, with_context.software
    finally:
        with_context.release()


def test_picture_is_nearer_to_one_of_many_samples(board, monkeypatch):
    many, _ = drawn(board, 4 * 384)
    true = many.reshape(384, 4, 384, 4, 3).mean((1, 3))
    one, software = drawn(board, 384)
    inside = (np.abs(many - many[0, 0]).sum(-1) > 0).reshape(384, 4, 384, 4).all((1, 3))
    error = np.sqrt(np.mean((one - true)[inside] ** 2))
    if software:
        monkeypatch.setattr(texture, "MIP_BIAS", 0.0)
        blurred, _ = drawn(board, 384)
        assert np.sqrt(np.mean((blurred - true)[inside] ** 2)) > 1.6 * error
    assert error < 4 / 255
