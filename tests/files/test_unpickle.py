"""Pickles of data: what is admitted comes back equal, everything else is refused and never run."""

import collections
import fractions
import io
import os
import pickle
import struct
import subprocess
import sys
import types

import numpy as np
import pytest
from smplh_model import model_fields

from avatar.body import builtin_body, read_body
from command.errors import AssetError
from files.unpickle import MAX_STEPS, read_pickle

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


def saved(path, value, protocol=4):
    path.write_bytes(pickle.dumps(value, protocol))
    return path


def same(a, b):
    if isinstance(a, np.ndarray):
        assert isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            same(a[key], b[key])
    elif isinstance(a, (list, tuple)):
        assert type(a) is type(b) and len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y)
    else:
        assert a == b and type(a) is type(b)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_plain_data_comes_back_equal(tmp_path, protocol):
    rng = np.random.default_rng(0)
    shared = rng.normal(size=(3, 4))
    value = {
        "poses": rng.normal(size=(5, 156)),
        "float32": rng.normal(size=7).astype("f4"),
        "columns": np.asfortranarray(rng.normal(size=(4, 6))),
        "big endian": np.arange(5, dtype=">i4").astype("i4"),
        "text": "grün",
        "bytes": b"\x00\xff",
        "numbers": [0, 1, -1, 255, 256, 65536, -(2**31), 2**31, 2**63, -(2**70), 1.5, float("inf"), True, False, None],
        "tuple": (1, (2, 3), ()),
        "nested": {"a": {"b": [shared, shared]}},
        "scalar": np.float64(120.0),
        "gender": np.array("female"),
        "byte gender": np.array(b"female"),
        "bools": np.array([True, False]),
        "empty": np.zeros((0, 3)),
        "ordered": collections.OrderedDict([("b", 1), ("a", 2)]),
    }
    back = read_pickle(saved(tmp_path / "a.pkl", value, protocol), "data")
    value["ordered"] = dict(value["ordered"])
    same(value, back)
    assert back["nested"]["a"]["b"][0] is back["nested"]["a"]["b"][1]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_other_byte_orders_and_sets_are_understood(tmp_path, protocol):
    value = {"big": np.arange(4, dtype=">f8"), "set": {1}, "frozen": frozenset(["x"])}
    back = read_pickle(saved(tmp_path / "a.pkl", value, protocol), "data")
    np.testing.assert_array_equal(back["big"], np.arange(4.0))
    assert back["set"] == [1] and back["frozen"] == ["x"]


def test_arrays_of_objects_are_lists_and_text_of_python_2_is_latin1(tmp_path):
    value = {"poses": np.array([np.zeros(3), np.ones(2)], object)}
    back = read_pickle(saved(tmp_path / "a.pkl", value), "data")
    assert [a.tolist() for a in back["poses"]] == [[0, 0, 0], [1, 1]]
    (tmp_path / "a.pkl").write_bytes(b"(dp0\nS'gender'\np1\nS'fem\\xe4le'\np2\nsS'n'\nL5L\nsS'yes'\nI01\ns.")
    assert read_pickle(tmp_path / "a.pkl", "data") == {"gender": "femäle", "n": 5, "yes": True}
    (tmp_path / "b.pkl").write_bytes(b"\x80\x02}q\x00U\x01aq\x01T\x02\x00\x00\x00\xe4\xffq\x02s.")
    assert read_pickle(tmp_path / "b.pkl", "data") == {"a": "\xe4\xff"}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("kind", ["csc_matrix", "csr_matrix", "csc_array"])
def test_sparse_matrices_are_what_scipy_says(tmp_path, protocol, kind):
    sparse = pytest.importorskip("scipy.sparse", reason="scipy is not installed")
    rng = np.random.default_rng(1)
    dense = rng.normal(size=(52, 90)) * (rng.random((52, 90)) < 0.1)
    matrix = getattr(sparse, kind)(dense)
    back = read_pickle(saved(tmp_path / "a.pkl", {"J_regressor": matrix}, protocol), "data")
    np.testing.assert_array_equal(back["J_regressor"], dense)


def chumpy_module():
    """Classes with chumpy's names and states, so that they pickle as chumpy's objects do."""
    ch, reordering = types.ModuleType("chumpy.ch"), types.ModuleType("chumpy.reordering")

    class Ch:
        pass

    class Select:
        pass

    for module, kind in ((ch, Ch), (reordering, Select)):
        kind.__module__, kind.__qualname__ = module.__name__, kind.__name__
        setattr(module, kind.__name__, kind)
    return (ch, reordering, {"chumpy": types.ModuleType("chumpy"), "chumpy.ch": ch, "chumpy.reordering": reordering})


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_chumpy_arrays_are_their_values(tmp_path, protocol, monkeypatch):
    ch, reordering, modules = chumpy_module()
    x = np.arange(12.0).reshape(4, 3)
    a = ch.Ch()
    a.__dict__.update(x=x, _dirty_vars={"x"}, _itr=None, _cache={"drs": {}})
    picked = reordering.Select()
    picked.__dict__.update(a=a, idxs=np.array([0, 5, 7, 2]), preferred_shape=(2, 2))
    with monkeypatch.context() as patch:
        for name, module in modules.items():
            patch.setitem(sys.modules, name, module)
        path = saved(tmp_path / "a.pkl", {"v_template": a, "picked": picked}, protocol)
    back = read_pickle(path, "data")
    np.testing.assert_array_equal(back["v_template"], x)
    np.testing.assert_array_equal(back["picked"], [[0, 5], [7, 2]])


class Bomb:
    def __init__(self, place):
        self.place = place

    def __reduce__(self):
        return (open, (self.place, "w"))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_nothing_is_run_and_the_name_is_said(tmp_path, protocol):
    place = str(tmp_path / "executed")
    for value, name in [
        (Bomb(place), r"(_?io|builtins|__builtin__)\.open"),
        ({"a": [np.zeros(3), os.system]}, r"(posix|nt)\.system"),
        (collections.Counter("aab"), r"collections\.Counter"),
        (fractions.Fraction(1, 3), r"fractions\.Fraction"),
        (np.zeros(3).view(np.recarray), r"numpy\.(core\.records|rec|_core\.records)\.recarray"),
    ]:
        with pytest.raises(AssetError, match=rf"a\.pkl: expected data .*'{name}'.*nothing was run"):
            read_pickle(saved(tmp_path / "a.pkl", value, protocol), "data")
    assert not os.path.exists(place)


@pytest.mark.parametrize(
    "program, message",
    [
        (b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nmatrix\n(I0\ntS'b'\ntR.", "numpy.matrix"),
        (b"cnumpy\ndtype\n(S'f8'\nI0\nI1\ntRb.", "a state that is a NoneType"),
        (b"Px\n.", "PERSID"),
        (b"\x82\x01.", "EXT1"),
        (b"\x80\x05\x97.", "NEXT_BUFFER"),
        (b"\xff.", r"b'.xff' at byte 0: no pickle of plain data has this"),
        (b"N", "ends at byte 1"),
        (b".", "empty stack"),
        (b"g7\n.", "reference to object 7"),
        (b"e.", "APPENDS at byte 0: without a mark"),
        (b"I1\nI2\na.", "APPEND at byte 6: on a int"),
        (b"}]N s.", "b' ' at byte 3"),
        (b"}]Ns.", "a key that is a list"),
        (b"L" + b"9" * 300 + b"L\n.", "a whole number of 997 bits"),
        (b"L" + b"9" * 9000 + b"L\n.", "LONG at byte 0: Exceeds the limit"),
        (b"\x8b\xff\xff\xff\x7f", "LONG4 at byte 0: not enough data"),
        (b"\x8d" + struct.pack("<Q", 1 << 62), "BINUNICODE8 at byte 0: expected"),
        (b"\x8e" + struct.pack("<Q", 1 << 62), "BINBYTES8 at byte 0: expected"),
        (b"]q\x00h\x00a.", "hold themselves"),
        (b"c__builtin__\nset\n(I1\ntR.", "cannot be rebuilt"),
        (b"cnumpy\ndtype\n(S'V8'\nI0\nI1\ntR.", "'V8'"),
        (b"cnumpy\ndtype\n(S'S9999999999'\nI0\nI1\ntR.", "expected numbers or text"),
        (b"c_codecs\nencode\n(Vx\nS'rot13'\ntR.", "encoding rot13"),
        (b"c_codecs\nencode\n(Vx\nS'nonsense'\ntR.", "cannot be rebuilt"),
        (b"cchumpy.ch\nCh\n)\x81.", "a state that is a NoneType"),
        (b"ccopy_reg\n_reconstructor\n(c_codecs\nencode\nc__builtin__\nobject\nNtR.", "cannot be rebuilt"),
        (b"S'abc\n.", "STRING at byte 0: its argument must be quoted"),
        (b"X\x02\x00\x00\x00\xff\xfe\x93.", "can't decode byte 0xff"),
        (b"(i__builtin__\neval\n.", "INST at byte 1: no pickle"),
        (b"(c__builtin__\neval\no.", "'__builtin__.eval'"),
        # whoever makes an array of it would visit 2^60 items
        (b"I1\n" + b"q\x00h\x00\x86" * 60 + b".", "more than 2000000 items together"),
    ],
)
def test_broken_programs_are_refused_with_a_reason(tmp_path, program, message):
    (tmp_path / "a.pkl").write_bytes(program)
    with pytest.raises(AssetError, match=message) as error:
        read_pickle(tmp_path / "a.pkl", "data")
    assert "a.pkl" in str(error.value) and "\n" not in str(error.value)


def sparse_bomb():
    """A matrix of 2^40 by 2^20 that holds nothing."""
    state = (b"}(U\x06_shape" + b"\x8a\x06" + (1 << 40).to_bytes(6, "little") + b"J" + struct.pack("<i", 1)
             + b"\x86U\x04data" + ARRAY + b"U\x07indices" + ARRAY + b"U\x06indptr" + ARRAY + b"u")  # fmt: skip
    return b"cscipy.sparse.csc\ncsc_matrix\n)\x81" + state + b"b."


ARRAY = (b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nI0\n\x85S'b'\ntR(I1\nI2\n\x85cnumpy\ndtype\n"
         b"(S'i8'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntbI00\nU\x10" + bytes(16) + b"tb")  # fmt: skip
FRESH = b"c_codecs\nencode\n(h\x00S'latin1'\ntR0"
SHARED = b"](" + b"K\x01" * 1000 + b"eq\x000"  # a list of a thousand, remembered
PRIME = (1 << 61) - 1  # hashes of whole numbers are counted modulo this
ATTACKS = {
    "objects without end": b"}" * (MAX_STEPS + 10),
    "marks without end": b"(" * (MAX_STEPS + 10),
    "copies of a text": b"X" + struct.pack("<I", 1 << 20) + b"a" * (1 << 20) + b"q\x000" + FRESH * 2000,
    "a sparse matrix that is mostly promise": sparse_bomb(),
    "tuples in tuples, as a pose": b"}X\x05\0\0\0posesK\x01" + b"q\x00h\x00\x86" * 60 + b"s.",
    "tuples in tuples, as a key": b"}K\x01" + b"q\x00h\x00\x86" * 60 + b"K\x01s.",
    "tuples in tuples, in a set": b"\x8f(K\x01" + b"q\x00h\x00\x86" * 60 + b"\x90.",
    "a tuple as deep as the stack of C": b"})" + b"\x85" * 300_000 + b"K\x01s.",
    "lists as deep as the stack of C": b"]" * 300_000 + b"a" * 299_999 + b".",
    "made things as deep as the stack of C": b"c__builtin__\nlist\nq\x000h\x00)Rq\x01"
    + b"0h\x00h\x01\x85Rq\x01" * 150_000 + b"h\x01.",
    "copies of lists": SHARED + b"c__builtin__\nlist\nq\x010](" + b"h\x01h\x00\x85R" * 50_000 + b"e.",
    "copies of sets": SHARED + b"c__builtin__\nset\nq\x010](" + b"h\x01h\x00\x85R" * 50_000 + b"e.",
    "a list many times in a pose": b"}X\x05\0\0\0poses" + SHARED + b"](" + b"h\x00" * 50_000 + b"es.",
    "keys that collide": b"}(" + b"".join(
        b"\x8a\x0c" + (PRIME * n).to_bytes(12, "little") + b"N" for n in range(1, 30_000)) + b"u.",
    "fractions that collide": b"}(" + b"".join(
        b"G" + struct.pack(">d", n * 2.0**61) + b"N" for n in range(1, 30_000)) + b"u.",
    "a memo that is far away": b"Nr\xff\xff\xff\xff.",
    "a memo in text": b"Np4000000000\n.",
    "bytes by their number": b"c__builtin__\nbytes\nJ\xff\xff\xff\x7f\x85R.",
    "bytes that are not there": b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b".",
    "a frame that is not there": b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"N.",
    "a class given a state": b"c__builtin__\nlist\n(N}X\x04\0\0\0kindX\x04\0\0\0dictstb.",
    "a name with dots": b"\x80\x04X\x08\0\0\0builtinsX\x0e\0\0\0list.__class__\x93.",
    "keywords": b"\x80\x04c__builtin__\nlist\n)}\x92.",
}  # fmt: skip


@pytest.mark.parametrize("name", ATTACKS)
def test_work_is_bounded_whatever_the_program(tmp_path, name):
    """In a process of its own: what these did before was to end it, or to take gigabytes and minutes."""
    (tmp_path / "a.pkl").write_bytes(ATTACKS[name])
    program = (
        "import resource, sys\n"
        "from command.errors import AssetError\n"
        "from avatar.motion.pickled import read_pickled_motion\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + (1 << 29), used + (1 << 29)))\n"
        "seconds = round(resource.getrusage(resource.RUSAGE_SELF).ru_utime)\n"
        "resource.setrlimit(resource.RLIMIT_CPU, (seconds + 10, seconds + 10))\n"
        "try:\n    read_pickled_motion(sys.argv[1])\nexcept AssetError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path / "a.pkl")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-500:]
    assert "a.pkl: " in done.stdout and done.stdout.count("\n") == 1 and not done.stderr


def test_a_body_model_in_a_pickle_is_the_one_in_an_npz(tmp_path):
    sparse = pytest.importorskip("scipy.sparse", reason="scipy is not installed")
    fields = model_fields()
    np.savez(tmp_path / "a.npz", **{k: v for k, v in fields.items() if k != "bs_style"})
    fields["J_regressor"] = sparse.csc_matrix(fields["J_regressor"])
    a, b = read_body(tmp_path / "a.npz"), read_body(saved(tmp_path / "a.pkl", fields, 2))
    for name in ("vertices", "faces", "joints", "shape_directions", "joint_directions", "origin"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(a.skin.weights, b.skin.weights)
    np.testing.assert_array_equal(b.hands.mean[1], fields["hands_meanr"])
    np.testing.assert_array_equal(b.hands.components[0], fields["hands_componentsl"])


def test_what_is_no_model_in_a_pickle_is_named_and_a_body_without_hands_has_none(tmp_path):
    with pytest.raises(AssetError, match=r"a\.pkl: no v_template"):
        read_body(saved(tmp_path / "a.pkl", model_fields() | {"v_template": "text"}))
    with pytest.raises(AssetError, match="a dict of arrays, found a list"):
        read_body(saved(tmp_path / "a.pkl", [1, 2]))
    assert read_body(saved(tmp_path / "a.pkl", model_fields(hands=False))).hands is None
    assert builtin_body("male").hands is None


def test_pickles_written_step_by_step_are_read(tmp_path):
    """A pickler without memo and framing, as other languages write them."""
    file = io.BytesIO()
    pickler = pickle.Pickler(file, 3)
    pickler.fast = True
    pickler.dump({"fps": 30.0, "poses": np.arange(6.0).reshape(2, 3)})
    (tmp_path / "a.pkl").write_bytes(file.getvalue())
    back = read_pickle(tmp_path / "a.pkl", "data")
    assert back["fps"] == 30.0 and back["poses"].tolist() == [[0, 1, 2], [3, 4, 5]]
