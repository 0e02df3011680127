"""A folder that cannot be looked into: one line where something is to be written or read there, no Python error."""

import pytest

from forcectl.scenario.user_settings import UserSettings, user_settings

LONG = 300 * "n"  # no folder can have this name: looking into it fails as it does where that is not permitted


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "fig_2_8", "--out", f"{LONG}/run"], "cannot be written: File name too long"),
        (
            ["graph", "fig_2_8", "--fidelity", "OneDimensional", "--out", f"{LONG}/a.dot"],
            "cannot be written: File name",
        ),
        (["merge", f"{LONG}/one", "--out", "merged"], "does not exist: must hold sweep.json"),
    ],
)
def test_a_folder_that_cannot_be_looked_into_is_one_line(arguments, said, forcectl, tmp_path):
    code, out, err = forcectl(*arguments)
    assert (code, out, err.count("\n"), said in err) == (2, "", 1, True), err
    assert list(tmp_path.iterdir()) == []


def test_settings_in_a_folder_that_cannot_be_looked_into_are_none(monkeypatch, forcectl):
    monkeypatch.setenv("XDG_CONFIG_HOME", f"/{LONG}")
    assert forcectl("list")[0] == 0
    assert user_settings() == UserSettings()
