"""`selfscan inspect NAME.glb -o DIR`: the pictures, the page and the numbers of one avatar."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from avatar.gltf.avatar_file import avatar_place, read_avatar
from bench.inspect import accuracy_sections as accuracy
from bench.inspect import drawn_sections as drawn
from bench.inspect import surface_sections as surface
from bench.inspect.inspection import Inspector
from bench.inspect.options import InspectCommand
from bench.inspect.page import PageSection, page
from command.errors import missing_package
from command.progress import plural, progress
from files.whole import whole_folder, write_json, write_text
from player.gl.context import open_context


def inspect(options: InspectCommand) -> Inspector:
    """Write the folder; whole or not at all.

    Raises:
        AssetError: avatar or run cannot be read, or the folder holds other files.
    """
    path, run, avatar = avatar_place(options.avatar), options.run, read_avatar(options.avatar)
    try:
        field = None if run is None else accuracy.from_run(avatar.levels[0], run)
    except ModuleNotFoundError as error:
        raise missing_package(error.name, "inspect,train", "--run") from None
    with ExitStack() as stack:
        folder = stack.enter_context(whole_folder(options.output))
        context = open_context(options.context, None)
        stack.callback(context.release)  # again does nothing
        inspector = Inspector(avatar, path, context, field, options.size // 2 * 2)
        stack.callback(inspector.release)
        topics: list[Callable[[], list[PageSection] | PageSection | None]] = [
            *(partial(topic, inspector) for topic in (drawn.looks, drawn.face, drawn.posed)),
            # VTK makes contexts of its own: ours draws before, and is gone then
            context.release,
            *(partial(topic, inspector) for topic in (
                surface.parts, surface.weights, surface.seams, surface.cones, surface.triangles,
                accuracy.field_distance, accuracy.provenance,
            )),
        ]  # fmt: skip
        for topic in progress(topics, "topics", len(topics)):
            made = topic()
            inspector.sections += [s for s in (made if isinstance(made, list) else [made]) if s is not None]
        for picture in (picture for section in inspector.sections for picture in section.pictures):
            (folder / f"{picture.name}.png").write_bytes(picture.data)
        lines = [f"{path.name}, {plural(len(avatar.levels), 'level')}, view dependence: {avatar.default_view}"]
        lines += [] if run is None else [f"run: {run.name}"]
        write_text(folder / "inspect.html", page(avatar.name, lines, inspector.checks, inspector.sections))
        write_json(folder / "inspect.json", inspector.facts | {"checks": [vars(check) for check in inspector.checks]})
    return inspector
