"""Scenario part `environment: !Parts`: several surfaces, boxes and parts of assemblies, each with a name; or none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from forcectl.framework.fields import Config, slot


@dataclass(kw_only=True)
class EnvironmentPartsConfig(Config):
    """Scenario part `!Parts`: named parts, each of the kinds that fill `environment`. Empty: free space."""

    parts: dict[str, Any] = slot("environment", dict, meaning="by name; none: free space")
