"""A film drawn by many machines: each part a task of Dask, the pictures the same as on one machine.

The engine is Dask distributed, with which Slurm, Kubernetes and SSH clusters come; nothing here knows them. A
worker reads avatar and motion from the same paths and refuses if their content differs.
"""

import pickle
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from command.errors import AssetError
from files.whole import whole_file, whole_folder
from player.film.film import VIDEO, film_kind
from player.film.parts import Parts, fingerprint
from player.film.shot import Shot, ShotRenderer

# tasks a worker has in hand or waiting
AHEAD = 2


class DrawnPart(NamedTuple):
    # one video without a name, or PNG frames by name
    files: list[tuple[str, bytes]]
    renderer: str  # GL_RENDERER
    notes: list[str]


def draw_parts_on_cluster(
    address: str, shot: Shot, parts: Parts, fingerprints: Mapping[str, str]
) -> Iterator[tuple[tuple[int, int], DrawnPart]]:
    """Draw the missing parts on a cluster and write their files; yields each part once it is written.

    address is tcp://HOST:PORT of a scheduler, a scheduler file, or a number of processes to start here.

    Raises:
        AssetError: no scheduler answers, it has no workers, or a part could not be drawn.
    """
    from distributed import as_completed

    kind = film_kind(parts.out)
    kind = kind if kind in VIDEO else ""
    with cluster_client(address) as client:
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        waiting = iter(parts.missing())
        futures: dict[Any, tuple[int, int]] = {}

        def submit(count: int) -> list[Any]:
            begun = {
                client.submit(draw_part, shot, part, kind, dict(fingerprints), pure=False): part
                for part in islice(waiting, count)
            }
            futures.update(begun)
            return list(begun)

        results = as_completed(submit(AHEAD * workers))
        try:
            for future in results:
                part = futures.pop(future)
                try:
                    drawn = future.result()
                except AssetError:
                    raise
                except Exception as error:  # what a worker ran into, as one line
                    raise AssetError(f"frames {part[0]}:{part[1]} on the cluster: {error}") from None
                future.release()
                store_part(parts.piece(part)[0], drawn.files)
                yield part, drawn
                results.update(submit(1))
        finally:
            client.cancel(list(futures))


def store_part(path: Path, files: Sequence[tuple[str, bytes]]) -> None:
    if film_kind(path) in VIDEO:
        with whole_file(path) as file:
            file.write(files[0][1])
        return
    with whole_folder(path) as folder:
        for name, content in files:
            (folder / name).write_bytes(content)


@contextmanager
def cluster_client(address: str) -> Iterator[Any]:
    """A client of the cluster; a number starts one of so many processes here and stops it in the end."""
    from distributed import Client, LocalCluster

    if address.isdecimal():
        # one task at a time in each process: OpenGL belongs to one thread
        options: dict[str, Any] = {"dashboard_address": None, "host": "127.0.0.1"}
        options |= {"n_workers": int(address), "threads_per_worker": 1, "processes": True}
        with LocalCluster(**options) as cluster, Client(cluster) as client:
            yield client
        return
    try:
        where: dict[str, Any] = {"scheduler_file" if Path(address).is_file() else "address": address}
        client = Client(**where, timeout="10s")
    except (OSError, ValueError, TimeoutError) as error:
        raise AssetError(f"--workers {address}: no scheduler answers: {error}") from None
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise AssetError(f"--workers {address}: the scheduler has no workers")
        yield client


# -- in the worker

# one thread for all tasks of a process, whatever threads the worker has; begun with its first task
_drawing = ThreadPoolExecutor(1, "selfscan draws")
# the shot that is open, as it was asked for
_opened: tuple[bytes, ShotRenderer] | None = None


def draw_part(shot: Shot, part: tuple[int, int], kind: str, fingerprints: Mapping[str, str]) -> DrawnPart:
    """A task: draw some frames of a film. Its files and OpenGL stay open for the next part of the same film."""
    return _drawing.submit(_draw_part, shot, part, kind, fingerprints).result()


def _draw_part(shot: Shot, part: tuple[int, int], kind: str, fingerprints: Mapping[str, str]) -> DrawnPart:
    global _opened
    asked = pickle.dumps(shot)
    if _opened is None or _opened[0] != asked:
        if _opened is not None:
            _opened[1].release()
            _opened = None
        for name, expected in fingerprints.items():
            if fingerprint(name) != expected:
                raise AssetError(f"{name}: differs on this worker from the one on the machine that asks")
        _opened = asked, ShotRenderer(shot)
    opened = _opened[1]
    with TemporaryDirectory(prefix="selfscan-") as folder:
        out = Path(folder) / f"part{kind}"
        film = opened.film(out, range(*part))
        written = [out] if kind else sorted(out.glob("*.png"))
        files = [("" if kind else file.name, file.read_bytes()) for file in written]
    return DrawnPart(files, opened.context.renderer, film.notes)
