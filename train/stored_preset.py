"""The settings of a run as run.json holds them.

A run's networks are rebuilt from what was stored with it, so that editing a preset orphans no run. Runs of earlier
versions may lack settings that came later: these take their default, and today's preset where there is none.
"""

import math
from dataclasses import MISSING, asdict, fields, is_dataclass
from types import UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from avatar.skeleton import PARTS
from train.networks.hash import HashNetworks
from train.networks.paper import PaperNetworks
from train.networks.triplane import TriPlaneNetworks
from train.preset import PRESETS, Preset

NETWORKS = {"triplane": TriPlaneNetworks, "hash": HashNetworks, "paper": PaperNetworks}
# a setting that only one kind of networks has: runs of earlier versions do not name the kind
KIND_OF_SETTING = {"plane_size": "triplane", "rows": "hash", "geometry_layers": "paper"}


class StoredPreset(NamedTuple):
    """A preset read from run.json."""

    preset: Preset
    # what the file did not hold, by name, and was taken from the defaults or today's preset
    assumed: tuple[str, ...]


def preset_json(preset: Preset) -> dict[str, Any]:
    """All settings, JSON; each part's networks name their kind."""
    out = asdict(preset)
    for part, stored in zip(preset.parts, out["parts"], strict=True):
        kind = next(name for name, sizes in NETWORKS.items() if isinstance(part.networks, sizes))
        stored["networks"] = {"kind": kind, **stored["networks"]}
    return out


def preset_from_json(stored: object, name: object) -> StoredPreset:
    """The preset that `preset_json` wrote; `name` is the run's preset, taken as it is today where nothing is stored.

    Raises:
        ValueError: a setting is no number or word that it can be, or absent and without a value to take.
    """
    today = PRESETS.get(name) if isinstance(name, str) else None
    if stored is None:
        if today is None:
            raise ValueError(f"no settings are stored, and preset should be one of {sorted(PRESETS)}, is {name!r}")
        return StoredPreset(today, ("settings",))
    reader = _Reader([])
    preset = reader.record(Preset, stored, today, "settings")
    if len(preset.parts) != len(PARTS):
        raise ValueError(f"settings.parts should hold {len(PARTS)}, holds {len(preset.parts)}")
    return StoredPreset(preset, tuple(reader.assumed))


class _Reader(NamedTuple):
    """Reads settings by the types of their dataclasses."""

    assumed: list[str]

    def record(self, kind: Any, stored: object, today: Any, place: str) -> Any:
        """A dataclass; `today` is the same of today's preset or None."""
        if not isinstance(stored, dict):
            raise ValueError(f"{place} should be an object, is {type(stored).__name__}")
        types, values = get_type_hints(kind), {}
        for entry in fields(kind):
            here = f"{place}.{entry.name}"
            if entry.name in stored:
                now = getattr(today, entry.name, None)
                values[entry.name] = self.value(types[entry.name], stored[entry.name], now, here)
                continue
            if entry.default is MISSING and not hasattr(today, entry.name):
                raise ValueError(f"{here} is absent")
            values[entry.name] = getattr(today, entry.name) if entry.default is MISSING else entry.default
            self.assumed.append(here)
        return kind(**values)

    def value(self, kind: Any, stored: Any, today: Any, place: str) -> Any:
        """One setting."""
        if is_dataclass(kind):
            return self.record(kind, stored, today, place)
        if get_origin(kind) in (Union, UnionType):
            return self.networks(stored, today, place)
        if get_origin(kind) is tuple:
            return self.several(get_args(kind), stored, today, place)
        if get_origin(kind) is Literal:
            fits = stored in get_args(kind)
        elif kind is float:
            fits = isinstance(stored, int | float) and not isinstance(stored, bool) and math.isfinite(stored)
        else:
            fits = type(stored) is kind
        if not fits:
            expected = get_args(kind) or kind.__name__
            raise ValueError(f"{place} should be {expected}, is {stored!r}")
        return float(stored) if kind is float else stored

    def several(self, kinds: tuple[Any, ...], stored: Any, today: Any, place: str) -> tuple[Any, ...]:
        """A tuple: of one type and any length, or with a type for each of its places."""
        if not isinstance(stored, list):
            raise ValueError(f"{place} should be a list, is {type(stored).__name__}")
        if kinds[-1] is ...:
            kinds = kinds[:1] * len(stored)
        if len(kinds) != len(stored):
            raise ValueError(f"{place} should hold {len(kinds)}, holds {len(stored)}")
        now = today if isinstance(today, tuple) and len(today) == len(stored) else (None,) * len(stored)
        return tuple(
            self.value(kind, one, then, f"{place}[{number}]")
            for number, (kind, one, then) in enumerate(zip(kinds, stored, now))
        )

    def networks(self, stored: Any, today: Any, place: str) -> TriPlaneNetworks | HashNetworks | PaperNetworks:
        """Sizes of a part's networks, by the kind that they name or by a setting that only one kind has."""
        if not isinstance(stored, dict):
            raise ValueError(f"{place} should be an object, is {type(stored).__name__}")
        kind = stored.get("kind", next((KIND_OF_SETTING[key] for key in KIND_OF_SETTING if key in stored), None))
        if not isinstance(kind, str) or kind not in NETWORKS:
            raise ValueError(f"{place}.kind should be one of {', '.join(NETWORKS)}, is {kind!r}")
        return self.record(NETWORKS[kind], stored, today if isinstance(today, NETWORKS[kind]) else None, place)
