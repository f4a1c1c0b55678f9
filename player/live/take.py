"""A live take: received poses, recorded on disk at once, at the end resampled to an even rate and written as AMASS.

While it is recorded, the frames lie in FILE.recording, one record each. Whatever ends the program costs at most the
frame in hand: the next recording to the same FILE first saves what lies there beside it. Memory does not grow.
"""

import os
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.motion.amass import write_amass
from avatar.motion.clip import Motion
from avatar.rotation import between
from command.errors import AssetError
from command.progress import plural
from files.whole import check_file, locked
from player.draw.drawing import Pose
from player.scene.motions import BLOCK

# 80 minutes at 60 frames a second; at most so many are recorded, and at most so many are written
MOST_FRAMES = 300_000
USUAL_RATES = (24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 240)
# frames a second; poses that came faster came in a burst
FASTEST = 1000.0
LONGEST_PAUSE = 2.0  # seconds; a longer silence is cut to this
MAGIC = b"selfscan-take-2\n"
# pelvis height of the sender's body in metres, NaN where it is not known; the CRC-32 of what stands before it
HEADER = np.dtype([("magic", "S16"), ("pelvis_height", "<f8"), ("check", "<u4")])
# joints, then the root; weights of the face, then yaw and pitch of each eye, NaN where the sender says nothing of them;
# the CRC-32
RECORD = np.dtype([("time", "<f8"), ("pose", "<f4", (53, 3)), ("face", "<f2", 56), ("check", "<u4")])
# frames between two notes of the pelvis height
NOTED = 64


class Take:
    """Frames of a live source, in the order of their times. Stops at `most` rather than fill the disk.

    Raises:
        AssetError: the file cannot be written, or another process records into it.
    """

    def __init__(self, path: Path | str, most: int = MOST_FRAMES):
        self.path, self.most = Path(path), most
        check_file(path)
        self.recording = self.path.with_name(self.path.name + ".recording")
        self.notes: list[str] = []
        self.frames = 0
        # why no more frames are taken
        self.stopped: str | None = None
        self.sender_height: Callable[[], float | None] = lambda: None
        try:
            self.file = os.open(self.recording, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise AssetError(f"{self.recording}: cannot be written: {error.strerror}") from None
        try:
            if locked(self.file) is False:
                raise AssetError(f"{path}: another process records into it; choose another name")
            if os.fstat(self.file).st_size:
                self._recover_interrupted_take()
            os.ftruncate(self.file, 0)
            os.write(self.file, _signed(np.array([(MAGIC, np.nan, 0)], HEADER)))
        except BaseException:
            os.close(self.file)
            raise

    def add(self, time: float | int, pose: Pose) -> None:
        """The next frame. A disk that is full stops the take, not the program."""
        if self.stopped is not None:
            return
        if self.frames >= self.most:
            self.stopped = "as many as a take holds"
            return
        numbers = np.concatenate([pose.axis_angle, pose.root[None]]).astype(np.float32)
        face = np.full(56, np.nan) if pose.face is None else np.append(pose.face.weights, pose.face.gaze)
        data = _signed(np.array([(time, numbers, face, 0)], RECORD))
        place = HEADER.itemsize + self.frames * RECORD.itemsize
        try:
            if os.pwrite(self.file, data, place) < len(data):
                raise OSError(28, "No space left on device")
            if self.frames % NOTED == 0:
                self._note_height()
        except OSError as error:
            self.stopped = error.strerror or str(error)
            return
        self.frames += 1

    def motion(self) -> Motion:
        """The take so far at an even rate; see `even_motion`."""
        return even_motion(_records(self.recording)[: self.frames], self.sender_height(), str(self.path))

    def finish(self) -> list[str]:
        """Write the take as an AMASS file, whole or not at all, and remove the recording; what was done, in lines.

        Raises:
            AssetError: it cannot be written; the recording is kept.
        """
        if not self.frames:
            self.close()
            self.recording.unlink(missing_ok=True)
            return [*self.notes, "no pose came: no take written"]
        try:
            self._note_height()
            motion = self.motion()
            write_amass(self.path, motion)
        except BaseException as error:
            self.close()
            kept = f"{plural(self.frames, 'frame')} kept in {self.recording}; recording to {self.path} again saves them"
            raise AssetError(f"{error}; {kept}" if isinstance(error, AssetError) else kept) from None
        self.close()
        self.recording.unlink(missing_ok=True)
        lines = [*self.notes, *motion.notes]
        if self.stopped is not None:
            lines.append(f"take: stopped after {plural(self.frames, 'frame')}: {self.stopped}")
        return [*lines, f"{self.path}: {plural(motion.frames, 'frame')} at {motion.rate:g} a second"]

    def close(self) -> None:
        os.close(self.file)

    def _note_height(self) -> None:
        height = self.sender_height()
        os.pwrite(self.file, _signed(np.array([(MAGIC, np.nan if height is None else height, 0)], HEADER)), 0)

    def _recover_interrupted_take(self) -> None:
        """Write what a killed process recorded for this path to a file of its own."""
        records, height = _records(self.recording), _height(self.recording)
        sound = np.fromiter((_is_signed(row.tobytes()) for row in records), bool, len(records))
        if not sound.all():
            self.notes.append(f"{self.recording}: {plural(int((~sound).sum()), 'damaged frame')} left out")
            records = records[sound]
        if not len(records):
            return
        names = (self.path.with_name(f"{self.path.stem}-recovered{n or ''}.npz") for n in range(1 << 30))
        kept = next(name for name in names if not name.exists())
        write_amass(kept, even_motion(records, height, str(kept)))
        self.notes.append(f"{kept}: {plural(len(records), 'frame')} of a take that was cut off")


def even_motion(records: np.ndarray, pelvis_height: float | None, name: str) -> Motion:
    """Recorded frames at an even rate: the usual one nearest to the median step, else that step's own.

    Each frame goes to its nearest tick and keeps its pose to the bit; of two on one tick the later stays; ticks
    without a frame are filled on the shorter arc, faces, which rest where there is none, straight. Where there
    would be more than MOST_FRAMES, the rate is lower.
    """
    steps = np.minimum(np.maximum(np.diff(records["time"]), 0.0), LONGEST_PAUSE)
    seconds = np.concatenate([[0.0], np.cumsum(steps)])
    rate, notes = even_rate(steps), ()
    if seconds[-1] * rate > MOST_FRAMES:
        notes = (f"take: at {rate:g} a second it would have more than {MOST_FRAMES} frames",)
        rate = MOST_FRAMES / seconds[-1]
    ticks = np.round(seconds * rate).astype(np.int64)
    # the later of two on one tick
    last = np.append(np.flatnonzero(np.diff(ticks)), len(ticks) - 1)
    ticks = ticks[last] - ticks[last[0]]

    def recorded(field: str, start: int, stop: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A field of the frames before and after the ticks, and which part of the way each is: 0 on a frame's own."""
        wanted = np.arange(start, stop)
        after = np.searchsorted(ticks, wanted)
        before = np.where(ticks[after] == wanted, after, after - 1)
        a, b = (records[field][last[chosen]].astype(np.float64) for chosen in (before, after))
        return a, b, (wanted - ticks[before]) / np.maximum(ticks[after] - ticks[before], 1)

    def block(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        a, b, part = recorded("pose", start, stop)
        turned = between(a[:, :52], b[:, :52], np.repeat(part[:, None], 52, 1))
        return np.where(part[:, None, None] > 0, turned, a[:, :52]), a[:, 52] + part[:, None] * (b - a)[:, 52]

    def faces(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        a, b, part = recorded("face", start, stop)
        out = np.nan_to_num(a) + part[:, None] * (np.nan_to_num(b) - np.nan_to_num(a))
        return out[:, :52], out[:, 52:].reshape(-1, 2, 2)

    some = any(np.isfinite(records["face"][k : k + BLOCK, 0]).any() for k in range(0, len(records), BLOCK))
    return Motion(name, int(ticks[-1]) + 1, rate, notes, block, pelvis_height, faces=faces if some else None)


def even_rate(steps: Float[np.ndarray, "steps"]) -> float:
    """Frames a second of the usual step: a usual rate within 2 %, else the median's own; 30 for a single frame."""
    steps = steps[steps > 1e-4]
    if not len(steps):
        return 30.0
    rate = min(1 / float(np.median(steps)), FASTEST)
    nearest = min(USUAL_RATES, key=lambda usual: abs(usual - rate))
    return float(nearest) if abs(nearest - rate) < 0.02 * nearest else rate


def _signed(row: np.ndarray) -> bytes:
    """The bytes of a record or header with its check."""
    data = row.tobytes()[:-4]
    return data + zlib.crc32(data).to_bytes(4, "little")


def _is_signed(data: bytes) -> bool:
    return zlib.crc32(data[:-4]) == int.from_bytes(data[-4:], "little")


def _records(path: Path) -> np.ndarray:
    """The whole records of a recording, read from the disk where they are used."""
    count = max(path.stat().st_size - HEADER.itemsize, 0) // RECORD.itemsize
    if not count:
        return np.zeros(0, RECORD)
    return np.memmap(path, RECORD, "r", HEADER.itemsize, (count,))


def _height(path: Path) -> float | None:
    """The pelvis height that a recording notes.

    Raises:
        AssetError: the file is no recording.
    """
    head = np.fromfile(path, np.uint8, HEADER.itemsize).tobytes()
    if len(head) < HEADER.itemsize or not head.startswith(MAGIC):
        raise AssetError(f"{path}: expected what is left of a take, found something else; move it away")
    height = float(np.frombuffer(head, HEADER)["pelvis_height"][0])
    return height if _is_signed(head) and np.isfinite(height) and height > 0 else None
