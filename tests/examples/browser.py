"""Pages in a browser without a window, where there is one."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), "")
needs_chromium = pytest.mark.skipif(not CHROMIUM, reason="no Chromium or Chrome on this machine to open the page")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1400,600",
    "--virtual-time-budget=3000",
]
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # Meshcat without a graphics card


def opened_in_browser(folder: Path, page: str, *options: str) -> str:
    """The document after three seconds, or what the options ask for."""
    path = folder / "page.html"
    path.write_text(page, encoding="utf-8")
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={folder / 'profile'}", *options, path.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


def with_script(page: str, script: str) -> str:
    """The page, and what a user would do in it; `say(x)` leaves a note that the test can read."""
    helpers = """
    const note = text => Object.assign(document.createElement("pre"), {textContent: "SAID " + text});
    const say = text => document.body.append(note(text));
    const send = (element, type) => element.dispatchEvent(
      new PointerEvent(type, {bubbles: true, button: 0, clientX: 400, clientY: 300}));
    const click = element => { send(element, "pointerdown"); send(element, "pointerup"); };
    const find = path => document.querySelector(`[data-path="${CSS.escape(path)}"]`);
    addEventListener("error", event => say("ERROR " + event.message));
    """
    return page.replace("</body>", f"<script>{helpers}\n{script}</script></body>")


def said(dom: str) -> list[str]:
    """The notes."""
    return re.findall(r"SAID (.*?)</pre>", dom)
