"""Settings of a user for all scenarios: `settings.yaml` in the folder `forcectl` of the user's configuration files.

That is `$XDG_CONFIG_HOME/forcectl/settings.yaml`, and `~/.config/forcectl/settings.yaml` where the variable is not set.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from forcectl.errors import BadInputError
from forcectl.framework.fields import Config, key
from forcectl.framework.files.text_file import yaml_text
from forcectl.framework.imports import allowed_names, settings_file
from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import Tagged, parse, place


@dataclass(kw_only=True)
class UserSettings(Config):
    """The keys of `settings.yaml`."""

    allow_imports: list[str] = key([], "modules that every scenario may import, as with --allow-imports")

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed_names(self.allow_imports, "allow_imports")


def user_settings() -> UserSettings:
    """The user's settings; the defaults where there is no file, or its folder may not be entered.

    Raises:
        BadInputError: the file cannot be read, or holds an unknown key or a wrong value.
    """
    file = settings_file()
    if not os.path.isfile(file):  # `Path.is_file` raises where the folder may not be entered
        return UserSettings()
    try:
        text = yaml_text(file)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise BadInputError(f"cannot read settings file {str(file)!r}: {reason}") from None
    tree = parse(text, str(file))
    lines = tree.lines if isinstance(tree, Tagged) else {}
    return Reader(lambda key: place(str(file), lines, key)).dataclass(UserSettings, tree or Tagged())
