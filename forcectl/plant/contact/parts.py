"""Scenario part `environment: !Parts`: several surfaces, boxes and parts of assemblies, each with a name; or none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from forcectl.errors import BadInputError
from forcectl.framework.fields import Config, slot


@dataclass(kw_only=True)
class EnvironmentPartsConfig(Config):
    """Scenario part `!Parts`: named parts, each of the kinds that fill `environment`. Empty: free space."""

    parts: dict[str, Any] = slot("environment", dict, meaning="surfaces, boxes and parts by name; empty: free space")

    def __post_init__(self) -> None:
        super().__post_init__()
        first: dict[Any, str] = {}
        for name, part in self.parts.items():
            if not hasattr(part, "occupies"):
                continue
            if (other := first.setdefault(part.occupies(), name)) != name:
                fault = f"is at the same place as parts.{other}: must be somewhere else, or left out"
                raise BadInputError(fault, key=f"parts.{name}")
