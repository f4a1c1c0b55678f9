"""The report of experiments/speed.py as Markdown and as a plot."""

from pathlib import Path
from typing import Any

from bench.report.writer import markdown_table, number
from files.whole import whole_file


def markdown(result: dict[str, Any]) -> str:
    """Tables: promises, sizes, peers, session; with the machine, and loudly when it was not quiet."""
    m = result["machine"]
    lines = [f"# Speed: {result['avatar']}", ""]
    if result["warning"]:
        lines += [f"> **{result['warning']}**", ""]
    load = "-" if m["load_average"] is None else f"{m['load_average']:.1f}"
    others = "-" if m["others_cpu_share"] is None else f"{100 * m['others_cpu_share']:.0f} %"
    lines += [
        f"{result['date']}, commit {m['commit'] or '-'}; {m['cpu']}, {m['cores']} cores; {m['renderer']} "
        f"({m['context']}); "
        f"Python {m['python']}; load {load}, other programs used {others} of the machine.",
        "",
        f"{result['faces']} triangles, {result['vertices']} vertices, {result['texture'][1]} x {result['texture'][0]} "
        f"texture; network: {result['network']}. Drawn to memory as RGBA, posing and read-back included.",
    ]
    promised = [row for row in (*result["bars"], *result["rows"]) if row.get("bar")]
    if promised:
        rows = [[r["name"], value(r), " ".join((r["bar"], r["unit"])).strip(), "met" if r["met"] else "**not met**"]
                for r in promised]  # fmt: skip
        lines += ["", "## What is promised", "", *markdown_table(["", "found", "promised", ""], rows)]
    for size in result["sizes"]:
        width, height = size["size"]
        lines += [
            "",
            f"## {width} x {height}, {100 * size['coverage']:.1f} % covered, {size['frames']} frames each",
            "",
        ]
        head = ["", "ms median", "p95", "±", "CPU ms", "frames/s", "of the bare skinned draw", "of its CPU time"]
        rows = []
        for r in size["rows"]:
            share = r["of_bare_skinned"]
            times = [number(r[key]) for key in ("ms_median", "ms_p95", "ms_spread", "cpu_ms_median")]
            shares = [f"{share['wall']:.2f} ± {share['spread']:.2f}", number(share["cpu"])]
            rows.append([r["name"], *times, number(r["fps"], 0), *shares])
        lines += markdown_table(head, rows)
    if result["peers"]:
        lines += peers_table(result["peers"])
    rest = [row for row in (*result["bars"], *result["rows"]) if row.get("value") is None or row.get("detail")]
    if rest:
        details = markdown_table(["", "value", ""], [[r["name"], value(r), r["detail"]] for r in rest])
        lines += ["", "## Details", "", *details]
    return "\n".join([*lines, "", "![frames a second](speed.png)", ""])


def value(row: dict[str, Any]) -> str:
    if row["value"] is None:
        return "-"
    digits = 0 if abs(row["value"]) >= 100 else 2 if row["value"] % 1 else 0
    return f"{row['value']:.{digits}f} {row['unit']}".strip()


def peers_table(peers: dict[str, Any]) -> list[str]:
    width, height = peers["size"]
    lines = [
        "",
        f"## Other players, {width} x {height}, a grey body of {peers['vertices']} vertices, skinned for them "
        "beforehand",
        "",
        "Each in turns with ours. *default*: as the library comes, without shadows; *lightest*: normals given, "
        "antialiasing off where it can be. Ours textured, posed and skinned, without antialiasing.",
        "",
    ]
    rows = []
    for r in peers["rows"]:
        faster = "; ".join(f"{n} {f['wall']:.1f} ({f['cpu']:.1f})" for n, f in r["ours_faster"].items())
        times = [number(r[key], 1) for key in ("ms_median", "ms_p95", "cpu_ms_median", "fps")]
        name = f"{r['name']} {r['version']}, {r['style']}"
        rows.append([name, r["settings"], f"{100 * r['coverage']:.1f} %", *times, faster])
    head = ["", "settings", "covered", "ms median", "p95", "CPU ms", "frames/s", "ours faster: wall (CPU)"]
    lines += markdown_table(head, rows)
    return lines + [f"\n{name} was not timed: {why}" for name, why in peers["failed"].items()]


def plot(result: dict[str, Any], path: Path) -> None:
    """Milliseconds a frame, one bar a program: a group a size, and the peers."""
    from matplotlib.figure import Figure

    groups = [
        (f"{s['size'][0]} x {s['size'][1]}", [(r["name"], r["ms_median"], r["ms_p95"]) for r in s["rows"]])
        for s in result["sizes"]
    ]
    if result["peers"] and result["peers"]["rows"]:
        rows = [(f"{r['name']}, {r['style']}", r["ms_median"], r["ms_p95"]) for r in result["peers"]["rows"]]
        groups.append(("others, {} x {}".format(*result["peers"]["size"]), rows))
    if not groups:
        groups = [("nothing drawn", [])]
    counts = [max(1, len(rows)) for _, rows in groups]
    figure = Figure(figsize=(7.5, 1.2 + 0.27 * sum(counts)), dpi=110, layout="constrained")
    axes = figure.subplots(len(groups), 1, gridspec_kw={"height_ratios": counts}, squeeze=False)[:, 0]
    for ax, (title, rows) in zip(axes, groups, strict=True):
        names, medians, tails = zip(*rows, strict=True) if rows else ((), (), ())
        colors = [
            "0.6" if n.startswith("bare") else "tab:orange" if title.startswith("others") else "tab:blue" for n in names
        ]
        ax.barh(range(len(names)), medians, color=colors)
        ax.plot(tails, range(len(names)), "|", color="0.2")
        ax.set_yticks(range(len(names)), names, fontsize=7)
        ax.tick_params(axis="x", labelsize=7)
        ax.invert_yaxis()
        ax.set_title(title, fontsize=8, loc="left")
        for i, ms in enumerate(medians):
            ax.text(ms, i, f" {1000 / ms:.0f}/s", va="center", fontsize=7)
        ax.margins(x=0.15)
    axes[-1].set_xlabel("ms a frame: bar median, tick p95; frames a second beside", fontsize=8)
    if result["warning"]:
        figure.suptitle("machine was NOT QUIET", fontsize=9, color="tab:red")
    with whole_file(path) as file:
        figure.savefig(file, format="png")
