"""The panel of live poses: the sender, received and lost frames, and the latency of each picture."""

import numpy as np
from imgui_bundle import imgui

from player.gui.widgets import Widgets, tip_of
from player.live.playback import LivePlayback
from player.window.actions import T_POSE
from player.window.playback import Playback

SPANS = ("sent to received", "received to applied", "received to drawn")


def live_panel(ui: Widgets, playback: Playback) -> None:
    """A block for each source."""
    for number, (live, _) in enumerate(playback.live):
        imgui.push_id(number)
        _source(live)
        asked = live.countdown is not None
        text = f"T-pose in {live.countdown:.0f} s" if asked else "Take the T-pose in 3 s"
        if ui.button(text, tip_of(T_POSE), name="T-pose"):
            live.ask_for_t_pose()
        imgui.pop_id()


def _source(live: LivePlayback) -> None:
    facts = live.inbox.facts(live.clock())
    imgui.text(str(live.address))
    if facts.age is None:
        imgui.text_disabled("waiting for poses")
    else:
        imgui.text(f"{facts.rate:.0f} poses/s, the newest {1000 * facts.age:.0f} ms old")
        if not facts.tracking:
            imgui.text_colored(imgui.ImVec4(1.0, 0.6, 0.3, 1.0), "the sender lost its tracking")
    counts = {name: n for name, n in vars(facts.counters).items() if n or name in ("frames", "lost")}
    imgui.text_disabled(", ".join(f"{name} {n}" for name, n in counts.items()))
    spans = np.array(live.latency.spans).reshape(-1, 3)
    if len(spans) and imgui.begin_table("latency", 4, imgui.TableFlags_.sizing_stretch_prop):
        for text in ("ms", "p50", "p95", "p99"):
            imgui.table_next_column()
            imgui.text_disabled(text)
        for name, values in zip(SPANS, spans.T, strict=True):
            values = 1000 * values[np.isfinite(values)]
            imgui.table_next_column()
            imgui.text(name)
            for percentile in (50, 95, 99):
                imgui.table_next_column()
                imgui.text(f"{np.percentile(values, percentile):.1f}" if len(values) else "-")
        imgui.end_table()
