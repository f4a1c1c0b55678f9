import base64
import io
import json

import numpy as np
import pytest
from PIL import Image
from refusals import refused
from tiny_avatar import join_glb

from avatar.gltf.document import COMPONENT_TYPES, ELEMENT_SHAPES, read_gltf
from avatar.gltf.scene import (
    base_color_image,
    node_parents,
    primitives,
    read_primitive,
    read_skin,
    triangles,
    world_from_node,
)
from avatar.gltf.write import GltfBuilder
from avatar.rotation import matrix_from_axis_angle, quaternion_from_axis_angle
from command.errors import AssetError

ASSET = {"asset": {"version": "2.0"}}


def written(tmp_path, document, binary=b"\0\0\0\0"):
    path = tmp_path / "file.glb"
    path.write_bytes(join_glb(ASSET | document, binary))
    return read_gltf(path)


def one_accessor(tmp_path, binary, accessor, view=None):
    return written(
        tmp_path,
        {
            "buffers": [{"byteLength": len(binary)}],
            "bufferViews": [{"buffer": 0, "byteLength": len(binary)} | (view or {})],
            "accessors": [{"bufferView": 0} | accessor],
        },
        binary,
    )


PEOPLE = [
    ("characters/White_M_1_Casual.glb", 58724),
    ("characters/White_F_1_Casual.glb", 68120),
    ("characters/Black_M_2_Casual.glb", 58724),
    ("characters/Asian_F_2_Casual.glb", 68120),
    ("dressed/cc0_male_dressed_smplh52.glb", 29068),
    ("dressed/cc0_female_dressed_smplh52.glb", 29358),
]


@pytest.mark.parametrize("name, faces", PEOPLE)
def test_people_read_whole_and_rest_in_their_bind_pose(data, name, faces):
    gltf = read_gltf(data / name)
    world, found = world_from_node(gltf), 0
    for node in gltf.items("nodes"):
        if "mesh" not in node:
            continue
        skin = read_skin(gltf, node["skin"])
        at_rest = world[list(skin.nodes)] @ skin.joint_from_mesh
        assert np.ptp(at_rest, axis=0).max() < 1e-4  # one matrix for all joints, so blending changes nothing
        for i in range(len(primitives(gltf, node["mesh"]))):
            primitive = read_primitive(gltf, node["mesh"], i)
            np.testing.assert_allclose(primitive.attributes["WEIGHTS_0"].sum(axis=1), 1, atol=2e-6)
            assert primitive.attributes["JOINTS_0"].max() < len(skin.nodes)
            found += len(primitive.faces)
            Image.open(io.BytesIO(gltf.image(base_color_image(gltf, primitive.material)))).verify()
    assert found == faces


@pytest.mark.parametrize("kind", ["SCALAR", "VEC2", "VEC3", "VEC4"])
@pytest.mark.parametrize("dtype", COMPONENT_TYPES.values())
def test_accessors_round_trip(tmp_path, dtype, kind):
    values = np.arange(5 * 4).reshape(5, 4)[:, : int(np.prod(ELEMENT_SHAPES[kind]))]
    values = values.reshape(5, *ELEMENT_SHAPES[kind]).astype(dtype)
    builder = GltfBuilder()
    builder.add_accessor(np.zeros(3, np.uint8))  # puts the next one at an offset that needs padding
    builder.add_accessor(values)
    (tmp_path / "a.glb").write_bytes(builder.to_bytes(ASSET))
    found = read_gltf(tmp_path / "a.glb").accessor(1)
    assert found.dtype == values.dtype
    np.testing.assert_array_equal(found, values)


def test_a_name_that_is_no_text_is_written_as_json_that_strict_readers_take(tmp_path):
    (tmp_path / "a.glb").write_bytes(GltfBuilder().to_bytes(ASSET | {"nodes": [{"name": "née \U0001f600 \udcff"}]}))
    assert read_gltf(tmp_path / "a.glb").items("nodes")[0]["name"] == "née \U0001f600 ?"


def test_columns_and_strides_are_read_as_the_format_has_them(tmp_path):
    moved = np.eye(4, dtype=np.float32)[None].copy()
    moved[0, :3, 3] = 1, 2, 3
    builder = GltfBuilder()
    builder.add_accessor(moved)
    assert np.frombuffer(builder.binary, "<f4")[12:15].tolist() == [1, 2, 3]  # glTF 2.0, 3.6.2.2
    (tmp_path / "a.glb").write_bytes(builder.to_bytes(ASSET))
    np.testing.assert_array_equal(read_gltf(tmp_path / "a.glb").accessor(0), moved)
    table = np.arange(24, dtype="<f4").reshape(4, 6)
    accessor = {"componentType": 5126, "type": "VEC3", "count": 4, "byteOffset": 8}
    gltf = one_accessor(tmp_path, table.tobytes(), accessor, {"byteStride": 24})
    np.testing.assert_array_equal(gltf.accessor(0), table[:, 2:5])


@pytest.mark.parametrize(
    "code, stored, fractions",
    [
        (5121, [0, 51, 255], [0, 0.2, 1]),
        (5120, [-128, -127, 127], [-1, -1, 1]),
        (5123, [0, 13107, 65535], [0, 0.2, 1]),
        (5122, [-32768, -32767, 32767], [-1, -1, 1]),
    ],
)
def test_normalised_integers_become_fractions_when_asked(tmp_path, code, stored, fractions):
    raw = np.array(stored, COMPONENT_TYPES[code])
    accessor = {"componentType": code, "type": "SCALAR", "count": 3, "normalized": True}
    gltf = one_accessor(tmp_path, raw.tobytes(), accessor)
    np.testing.assert_array_equal(gltf.accessor(0), raw)
    np.testing.assert_allclose(gltf.accessor(0, as_float=True), fractions, atol=1e-7)


def gltf_with_uri(folder, uri):
    document = {
        "buffers": [{"byteLength": 12, "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteLength": 12}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "SCALAR", "count": 3}],
    }
    (folder / "a.gltf").write_text(json.dumps(ASSET | document))
    return read_gltf(folder / "a.gltf").accessor(0).tolist()


def test_buffers_come_from_data_uris_and_from_files_below_the_folder(tmp_path):
    values = np.array([1, 2, 3], "<f4").tobytes()
    (tmp_path / "a b").mkdir()
    (tmp_path / "a b" / "ü.bin").write_bytes(values)
    data_uri = "data:application/octet-stream;base64," + base64.b64encode(values).decode()
    assert gltf_with_uri(tmp_path, data_uri) == gltf_with_uri(tmp_path, "a%20b/%C3%BC.bin") == [1, 2, 3]


@pytest.mark.parametrize("uri", ["../secret", "%2e%2e/secret", "/secret", "link", "file:secret", "http://a/b", "..\\s"])
def test_a_file_outside_the_folder_is_never_opened(tmp_path, uri):
    (tmp_path / "secret").write_bytes(bytes(12))
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path / "secret")
    refused(AssetError, r"buffers\[0\].uri should", gltf_with_uri, folder, uri)


@pytest.mark.parametrize(
    "extension, advice",
    [
        ("EXT_meshopt_compression", "npx @gltf-transform/cli copy"),
        ("KHR_draco_mesh_compression", "npx @gltf-transform/cli copy"),
        ("KHR_texture_basisu", "npx @gltf-transform/cli ktxdecompress"),
        ("EXT_texture_avif", "npx @gltf-transform/cli png"),
        ("KHR_materials_pbrSpecularGlossiness", "npx @gltf-transform/cli metalrough"),
        ("EXT_mesh_gpu_instancing", "export the file without it"),
    ],
)
def test_an_unread_required_extension_is_named_with_its_converter(tmp_path, extension, advice):
    with pytest.raises(AssetError, match=f"'{extension}', which is not read here.*{advice}"):
        written(tmp_path, {"extensionsRequired": [extension]})


def test_world_transforms_are_products_down_the_tree(tmp_path):
    turn, scale, shift = np.array([0.3, -1.1, 0.6]), [1, 2, 3], [4.0, 5, 6]
    matrix = np.array([[0, -1, 0, 7], [1, 0, 0, 8], [0, 0, 1, 9], [0, 0, 0, 1.0]])
    nodes = [
        {"matrix": matrix.T.reshape(-1).tolist()},
        {"translation": shift, "rotation": quaternion_from_axis_angle(turn).tolist(), "scale": scale},
        {"children": [1]},
        {"translation": [1, 0, 0], "children": [0, 2]},
    ]
    gltf = written(tmp_path, {"nodes": nodes})
    expected = np.eye(4)
    expected[:3, :3] = matrix_from_axis_angle(turn) * scale
    expected[:3, 3] = np.add(shift, [1, 0, 0])
    assert node_parents(gltf).tolist() == [3, 2, 3, -1]
    np.testing.assert_allclose(world_from_node(gltf)[1], expected, atol=1e-12)
    np.testing.assert_allclose(world_from_node(gltf)[0][:3, 3], [8, 8, 9], atol=1e-12)


def test_triangles_are_lists(tmp_path):
    meshes = [{"primitives": [{"attributes": {}}, {"attributes": {}, "mode": 5}]}]
    gltf = written(tmp_path, {"meshes": meshes})
    assert triangles(gltf, 0, 0, 6).tolist() == [[0, 1, 2], [3, 4, 5]]
    refused(AssetError, "mode should be 4, a list of triangles, is 5", triangles, gltf, 0, 1, 6)


@pytest.mark.parametrize("transform, read", [({"offset": [0, 0], "scale": [1, 1]}, True), ({"scale": [2, 1]}, False)])
def test_a_texture_transform_is_refused_unless_it_moves_nothing(tmp_path, transform, read):
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    materials = [{"pbrMetallicRoughness": {"baseColorTexture": texture}}]
    document = {"materials": materials, "textures": [{"source": 0}], "images": [{"uri": "a.png"}]}
    gltf = written(tmp_path, document)
    if read:
        assert base_color_image(gltf, 0) == 0
    else:
        refused(AssetError, "KHR_texture_transform should be one that moves nothing", base_color_image, gltf, 0)
