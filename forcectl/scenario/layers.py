"""The layers of a scenario: defaults, preset, file, variant and overrides."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError, invalid, show, unknown
from forcectl.framework.yaml_tree import Tagged, Tree, equal, is_object, merge, nest, replaces
from forcectl.models import found_beside
from forcectl.scenario import catalog
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.trees import default_parts, default_tags, path_of

ONLY_VARIANT = "default"  # name of the one variant of a scenario without variants
_LONGEST_NAME, _MOST_VARIANTS = 200, 200  # characters; variants of a scenario
_OF_ALL = ("variants", "expect", "fidelities")  # keys that hold for all variants, so that none may set them

# Keys of earlier versions -> what to write instead.
_GONE = {
    "loop": "delete it, all scenarios have the same kind of loop",
    "estimator": "write estimators: {NAME: !Tag {...}}",
    "analysis": "write analyses: {NAME: !Tag {...}}",
    "loads": "write station.loads",
    "station.position_loop": "write station.drive.position_loop",
    "station.servo": "write station.drive.servo",
    "station.interface": "write station.drive",
    "station.force_sensor": "write station.sensors.force",
    "station.friction": "write station.drive.friction",
    "station.obstacles": "write station.environment: !Box {...}, or !Parts {parts: {NAME: !Box {...}}}",
}


class Layers:
    """The trees that make up a scenario, weakest first, each with the name that messages use.

    Args:
        file: file of the scenario.
        variant: name of one of its variants.
        overrides: values by dotted key.
        cls: class of the scenario, which holds the defaults.

    Raises:
        BadInputError: the variant is no mapping, the preset is unknown, or an override has no effect.
    """

    def __init__(self, file: ScenarioFile, variant: str, overrides: Mapping[str, Any], cls: type):
        self._file = file
        variants = file.tree.get("variants")
        changes = variants.get(variant) if isinstance(variants, Tagged) else None
        if changes is not None and not isinstance(changes, Tagged):
            key = f"variants.{variant}"
            raise invalid(key, changes, "a mapping of scenario keys").at(key, file.where(key))
        forced, varied = nest(overrides), nest(changes or {})
        self._overridden = [str(name).split(".") for name in overrides]
        # Origin of a default that conflicts with this variant only.
        self._variant = (f"variants.{variant}", f"variant {variant!r}") if varied else None
        # A slot without a tag has its default tag, also when a later layer changes only some of its keys.
        self._layers: list[tuple[Callable[[str], str], Tagged]] = [
            (lambda key: file.origin, default_tags(cls)),
            (file.where, file.tree),
            (lambda key: file.where(f"variants.{variant}.{key}", f"variant {variant!r}"), varied),
            (lambda key: "override", forced),
        ]
        if overrides:
            self._check_changes(overrides)
        name = self.merged().get("preset", catalog.DEFAULT_PRESET)
        if name not in catalog.list_presets():
            raise unknown("preset", name, catalog.list_presets()).at("preset", self.where("preset"))
        preset = catalog.find_preset(str(name), self._drive())
        preset.tree.pop("description", None)
        self._layers.insert(1, (lambda key: preset.where(key, f"preset {name!r}"), preset.tree))
        # A part that is added by its dotted key does not replace the default parts.
        for key, parts in default_parts(cls).items():
            dotted = {name for name in (*overrides, *(changes or {})) if str(name).startswith(f"{key}.")}
            whole = (nest({n: v for n, v in each.items() if n not in dotted}) for each in (changes or {}, overrides))
            if dotted and not any(_holds(tree, key.split(".")) for tree in (preset.tree, file.tree, *whole)):
                self._layers[0] = (self._layers[0][0], merge(self._layers[0][1], nest({key: parts})))

    def _check_changes(self, overrides: Mapping[str, Any]) -> None:
        """BadInputError for an override that would have no effect, or would hide a wrong value in the file."""
        written = Tagged()
        for _, layer in self._layers[1:-1]:  # without the defaults, whose parts an empty mapping removes
            written = merge(written, layer)
        for key, value in overrides.items():
            first, *rest = parts = str(key).split(".")
            if first == "variants":
                raise BadInputError("variants are those of the file: must not be overridden").at(key, "override")
            around: Tree = written
            for length, part in enumerate(rest, start=1):
                around = around.get(parts[length - 1]) if isinstance(around, Tagged) else None
                if isinstance(around, bool | int | float) or (isinstance(around, list) and not part.isdecimal()):
                    name = ".".join(parts[:length])
                    raise invalid(name, around, "a mapping").at(name, self._file.where(name))
            empty = isinstance(value, Mapping) and not value and not getattr(value, "tag", None)
            if empty and isinstance(around, Tagged) and around.get(parts[-1]):
                raise invalid(key, value, "a mapping with keys: an empty one changes nothing").at(key, "override")

    def _drive(self) -> str:
        """Tag of the drive; empty where none is found."""
        station = self.merged().get("station")
        drive = station.get("drive") if isinstance(station, Tagged) else getattr(station, "drive", None)
        if isinstance(drive, Tagged) and drive.given is None:
            return drive.tag or ""
        if isinstance(drive, str):
            return drive.removeprefix("!")
        tags = {path: tag for tag, path in catalog.tags_of("drive").items()}
        bases = map(path_of, type(getattr(drive, "given", drive)).__mro__)  # a subclass is a drive of its kind
        return next((tags[path] for path in bases if path in tags), "")

    def merged(self) -> Tagged:
        """All layers merged, the stronger on top."""
        result = Tagged()
        for _, tree in self._layers:
            result = merge(result, tree)
        return result

    def where(self, key: str) -> str:
        """Origin of the value at a dotted key: the strongest layer that holds it, or else the part around it."""
        parts = key.split(".")
        for each in self._overridden:  # of the key, of a part around or inside it; but a whole slot is from the file
            if parts[: len(each)] == each or (len(parts) > 1 and each[: len(parts)] == parts):
                return "override"
        given, forced = self._layers[max(self._replaced_by(parts), 1) : -1], self._layers[-1:]
        for length in range(len(parts), 0, -1):
            # Overrides of other keys come last: they count only where no layer but them has the part around both.
            for where, tree in (*reversed(given), *forced):  # a default has the origin of the part around it
                if _holds(tree, parts[:length]):
                    return where(key)
        return self._file.where(key) if self._variant is None else self._file.where(*self._variant)

    def _replaced_by(self, parts: list[str]) -> int:
        """Number of the strongest layer that replaces a part around a key: weaker ones say nothing of the key."""
        merged, found = Tagged(), 0
        for number, (_, tree) in enumerate(self._layers):
            for length in range(1, len(parts)):
                over, base = (_at(each, parts[:length]) for each in (tree, merged))
                if isinstance(over, Tagged) and isinstance(base, Tagged) and replaces(over, base):
                    found = number
            merged = merge(merged, tree)
        return found

    def check_gone(self, tree: Tagged) -> None:
        """BadInputError for a key of an earlier version.

        Args:
            tree: all layers, merged.
        """
        for gone, instead in _GONE.items():
            part, _, name = gone.rpartition(".")
            around = tree.get(part) if part else tree
            if isinstance(around, Tagged) and name in around:
                raise BadInputError(f"is no longer a key: {instead}").at(gone, self.where(gone))


def _at(tree: Tree, parts: list[str]) -> Tree:
    """The part of a tree at a key; None where there is none."""
    for part in parts:
        tree = tree.get(part) if isinstance(tree, Tagged) else None
    return tree


def _holds(tree: Tree, parts: list[str]) -> bool:
    for part in parts:
        if isinstance(tree, list) and part.isdecimal() and int(part) < len(tree):
            tree = tree[int(part)]
        elif isinstance(tree, Tagged) and part in tree:
            tree = tree[part]
        else:
            return is_object(tree) or (isinstance(tree, Tagged) and tree.given is not None)
    return True


def check_order(overrides: Mapping[str, Any], others: Mapping[str, Any]) -> None:
    """Refuse an override that replaces an earlier one, or contradicts an argument for the same key.

    Args:
        overrides: values by dotted key, in order.
        others: values of arguments, by the dotted key that they set.

    Raises:
        BadInputError: about the key.
    """
    for name, value in others.items():
        if (other := overrides.get(name, value)) != value:
            raise invalid(name, other, f"left out, or {value!r}, the value of the argument {name.rpartition('.')[2]}")
    names = [str(name) for name in overrides]
    for i, name in enumerate(names):
        if earlier := next((other for other in names[:i] if other.startswith(f"{name}.")), ""):
            raise BadInputError(
                f" replaces what {earlier} sets before it: must stand before it", key=f"overrides.{name}"
            )


def leave_out(tree: Tagged, preset: Tagged) -> None:
    """Write null for parts of a preset that a complete tree lacks: otherwise the preset would add them again."""
    for name, part in preset.items():
        if name == "description":
            continue
        own = tree.setdefault(name, None)
        if isinstance(own, Tagged) and own.tag is None and isinstance(part, Tagged):
            leave_out(own, part)


def select_variants(file: ScenarioFile, variant: str | None = None) -> list[str]:
    """The variants to run: the named one, else all.

    Raises:
        BadInputError: there is no variant of that name, or `variants` is invalid.
    """
    if not isinstance(variant, str | None):
        raise invalid("variant", variant, "the name of a variant or None")
    variants = file.tree.get("variants") or Tagged({ONLY_VARIANT: Tagged()})
    if not isinstance(variants, Tagged) or not all(isinstance(name, str) for name in variants):
        wanted = "a mapping of names to values (quote names)"
        raise invalid("variants", variants, wanted).at("variants", file.where("variants"))
    if len(variants) > _MOST_VARIANTS:
        text = f" has {len(variants)} variants: must be at most {_MOST_VARIANTS}; use a sweep"
        raise BadInputError(text).at("variants", file.where("variants"))
    try:
        check_names("variants", variants)
        for name, changes in variants.items():
            for key in changes if isinstance(changes, Tagged) else ():
                first, *rest = str(key).split(".")
                if first in _OF_ALL:
                    raise BadInputError(f" has {first} of its own: must not", key=f"variants.{name}")
                if rest and _holds(changes, [first, *rest]):
                    raise BadInputError(" stands twice: must stand once", key=f"variants.{name}.{key}")
        check_different("variants", {name: changes or Tagged() for name, changes in variants.items()})
    except BadInputError as error:
        raise error.at(error.key, file.where(error.key)) from None
    if variant is not None and variant not in variants:
        raise unknown(f"variant of {file.origin}", variant, variants)
    return list(variants) if variant is None else [variant]


def check_names(kind: str, names: Iterable[str]) -> None:
    """Refuse names that cannot be printed, and names that differ by case and blanks only.

    Args:
        kind: key of the mapping with these names.
        names: the names, as written.

    Raises:
        BadInputError: about `kind`.
    """
    read: dict[str, str] = {}
    for name in names:
        if not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
            raise BadInputError(f"the name {show(name)} must be 1 to {_LONGEST_NAME} printable characters", key=kind)
        other = read.setdefault("".join(name.split()).casefold(), name)
        if other != name:
            text = f"the name {show(name)} must differ from {show(other)} by more than case and blanks"
            raise BadInputError(text, key=kind)


def check_different(kind: str, changes: Mapping[str, Tree]) -> None:
    """Refuse two entries with equal changes, such as two equal variants.

    Args:
        kind: key of the mapping with the changes.
        changes: changes by the name of the entry.

    Raises:
        BadInputError: about the second of two equal entries.
    """
    read: dict[str, str] = {}
    for name, tree in changes.items():
        items = sorted(tree.items(), key=lambda item: str(item[0])) if isinstance(tree, Tagged) else tree
        other = read.setdefault(repr(items), name)  # equal keys and values; the tags may still differ
        if other != name and equal(tree, changes[other]):
            raise invalid(f"{kind}.{name}", tree, f"other values than those of {kind}.{other}")


def locate_files(tree: Tree, folder: Path) -> None:
    """Make relative paths of files, and of robot and tool folders, beside the scenario absolute."""
    folder = folder.absolute()
    station = tree.get("station") if isinstance(tree, Tagged) else None
    if isinstance(station, Tagged):
        tool = station.get("tool")
        arms = tool if isinstance(tool, Tagged) else Tagged()
        for part, name in ((station, "robot"), (station, "tool"), *((arms, arm) for arm in arms)):
            if isinstance(path := part.get(name), str):
                part[name] = found_beside(folder, path)
    _locate(tree, folder)


def _locate(tree: Tree, folder: Path) -> None:
    if isinstance(tree, Tagged):
        for name in ("path", "model", "gains_from"):
            path = tree.get(name)
            if isinstance(path, str) and path and os.path.isfile(folder / path):
                tree[name] = str(folder / path)
        for part in tree.values():
            _locate(part, folder)
