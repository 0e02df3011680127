"""Scenario part `environment: !Parts`: several surfaces and boxes, each with a name; or none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from forcectl.framework.fields import Config, named_slots


@dataclass(kw_only=True)
class EnvironmentPartsConfig(Config):
    """Scenario part `!Parts`: named parts, each of the kinds that fill `environment`. Empty: free space."""

    parts: dict[str, Any] = named_slots("environment", meaning="by name; none: free space")
