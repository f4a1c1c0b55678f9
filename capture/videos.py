"""Videos that are read when they are asked for: four of 1080p and 100 frames are 4 GB. What there is room for stays."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

import numpy as np

if TYPE_CHECKING:
    from capture.folder import PartVideo

# bytes of videos that are kept once they were read: at least, at most, and share of the machine's memory between them;
# the last one always is
KEPT, MOST, SHARE = 800_000_000, 3_000_000_000, 0.12


class Videos(Mapping[str, "PartVideo"]):
    """Videos by part. Who holds one keeps it in memory; of the others those read last stay, up to `most_kept` bytes."""

    def __init__(self, read: Mapping[str, Callable[[], "PartVideo"]], recent: "list[PartVideo] | None" = None):
        self.read = dict(read)
        self._alive: WeakValueDictionary[str, PartVideo] = WeakValueDictionary()
        # one list for all that are made from the same, or each would keep its own
        self.recent: list[PartVideo] = [] if recent is None else recent

    def __getitem__(self, part: str) -> "PartVideo":
        video = self._alive.get(part)
        if video is None:
            # room is made first: both at once would be twice the memory
            while self.recent and sum(sizes := [size_of(one) for one in self.recent]) + max(sizes) > most_kept():
                self.recent.pop(0)
            video = self._alive[part] = self.read[part]()
        self.recent[:] = [one for one in self.recent if one is not video] + [video]
        while len(self.recent) > 1 and sum(map(size_of, self.recent)) > most_kept():
            self.recent.pop(0)
        return video

    def __iter__(self) -> Iterator[str]:
        return iter(self.read)

    def __len__(self) -> int:
        return len(self.read)


def changed(
    videos: Mapping[str, "PartVideo"], change: Callable[[str, "PartVideo"], "PartVideo"]
) -> Mapping[str, "PartVideo"]:
    """Videos as `change` makes them, each when it is asked for; those that are read stay unread until then."""
    if not isinstance(videos, Videos):
        return {part: change(part, video) for part, video in videos.items()}
    made = {part: lambda part=part, read=read: change(part, read()) for part, read in videos.read.items()}
    return Videos(made, videos.recent)


def only(videos: Mapping[str, "PartVideo"], parts: Sequence[str]) -> Mapping[str, "PartVideo"]:
    if not isinstance(videos, Videos):
        return {part: videos[part] for part in parts}
    return Videos({part: videos.read[part] for part in parts}, videos.recent)


def let_go(videos: Mapping[str, "PartVideo"]) -> None:
    """Free the videos that can be read again and have no other holder."""
    if isinstance(videos, Videos):
        videos.recent.clear()


def most_kept() -> int:
    """Bytes of videos that this machine keeps: four of 1080p read anew for each use take a third of a training that
    learns nothing."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0
    return max(KEPT, min(MOST, int(SHARE * memory)))


def size_of(video: "PartVideo") -> int:
    return sum(0 if pixels is None else pixels.nbytes for pixels in (video.images, video.masks, video.unsure))


def even(count: int, wanted: int) -> list[int]:
    """At most `wanted` of `count` frames, evenly spread; the last is left out, where a turn is where it began."""
    return [int(i) for i in np.unique(np.linspace(0, count, wanted, endpoint=False).astype(int))]
