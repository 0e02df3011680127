"""Places of values in a YAML text: dotted key and line."""

from __future__ import annotations

from collections.abc import Iterator

import yaml

from forcectl.errors import BadInputError


def places(root: yaml.Node) -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
    """Every dotted key of a text, with the node at which it begins and the node of its value; outer ones first."""
    waiting = [(root, "")]
    for node, key in waiting:  # the list grows meanwhile
        entries = node.value if not isinstance(node, yaml.ScalarNode) else []
        for i, entry in enumerate(entries):
            name, part = entry if isinstance(node, yaml.MappingNode) else (None, entry)
            inner = f"{key}.{name.value if name else i}".removeprefix(".")
            yield inner, name or part, part
            waiting.append((part, inner))


class ZeroBeforeError(yaml.YAMLError):
    """A number with a leading zero: octal in YAML 1.1 and decimal in YAML 1.2."""

    def __init__(self, node: yaml.ScalarNode):
        super().__init__(node.value)
        self._node = node

    def bad_input(self, root: yaml.Node | None, origin: str) -> BadInputError:
        """The error for the user.

        Args:
            root: root node of the text; None where it is not known.
            origin: label of the file in messages.
        """
        shown, line = self._node.value[:40], self._node.start_mark.line + 1
        key = next((key for key, _, part in places(root) if part is self._node), "") if root is not None else ""
        allowed = f"written without the zero before it, or as '{shown}' for text"
        text = f"{' = ' if key else ''}{shown}: must be {allowed}"
        error = BadInputError(text, value=self._node.value, allowed=allowed)
        return error.at(key, f"{origin}:{line}" if key else origin)
