"""Where a number was measured: processor, renderer, load, and the commit of the code."""

import os
import platform
import subprocess
from pathlib import Path

from bench.report.writer import Json


def machine(renderer: str, kind: str) -> Json:
    """What a reader needs to know beside a measured number; `renderer` and `kind` name the OpenGL context."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "cpu": cpu_name(),
        "cores": cores,
        "renderer": renderer,
        "context": kind,
        "python": platform.python_version(),
        "load_average": load,
        "commit": commit(),
    }


def commit() -> str | None:
    """Short name of the checked-out commit, with "+" where files differ from it; None outside a repository."""
    folder = Path(__file__).parent
    try:
        answer = subprocess.run(
            ["git", "describe", "--always", "--dirty=+"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() or None if answer.returncode == 0 else None


def cpu_name() -> str:
    """The processor's own name."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        # not Linux: the platform module's word has to do
        pass
    return platform.processor() or platform.machine()
