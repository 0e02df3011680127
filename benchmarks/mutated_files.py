"""Random faults in scenarios, robots, tables and logs: each is used, or refused in one short line; never a traceback.

`python benchmarks/mutated_files.py 1000 --seed 5` makes so many files of each kind. What gives anything else is printed
and kept in the working directory, and so is what takes longer than 20 s of one processor.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

_LONGEST = 20.0  # [s] of one processor
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
_VALUES = (
    b"-1",
    b"0",
    b"1e9",
    b"-1e300",
    b"nan",
    b"inf",
    b"x",
    b"",
    b"1 2",
    b"1e400",
    b"0x1",
    b"\xb8",
    b"'",
    b"<",
    b"&",
)

_COMMON = b" \n,:;{}[]<>=\"'/#&*!-+.0123456789aenxyz"

Case = tuple[Path, Callable[[], object]]  # a mutated file or folder, and what reads it


def mutated(data: bytes, rng: random.Random) -> bytes:
    """One or two faults in the text or the bytes of a file."""
    for _ in range(rng.randint(1, 2)):
        kind, i = rng.randrange(8), rng.randrange(len(data) + 1)
        numbers = list(_NUMBER.finditer(data[:200_000])) if kind < 4 else []
        if numbers:
            found = rng.choice(numbers)
            data = data[: found.start()] + rng.choice(_VALUES) + data[found.end() :]
        elif kind == 4:
            data = data[:i] + data[i + rng.randint(1, 60) :]
        elif kind == 5:
            data = data[:i]
        else:
            size = rng.randint(1, 12)
            put = rng.randbytes(size) if rng.random() < 0.3 else bytes(rng.choices(_COMMON, k=size))
            data = data[:i] + put + data[i + (size if kind == 6 else 0) :]
    return data


def scenarios(folder: Path, rng: random.Random) -> Iterator[Case]:
    """Every shipped experiment with faults in its tree or its text."""
    from tests.cli.test_bad_input_fuzz import mutants, try_out

    path = folder / "mutant.yaml"
    for text, own in mutants(sys.maxsize, rng.random()):
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        yield path, lambda own=own: try_out(path, own)


def robots(folder: Path, rng: random.Random) -> Iterator[Case]:
    """A robot's folder with faults in its URDF file or its parameters."""
    from forcectl.robot.model import RobotModel
    from tests.examples.robot_folders import write_planar_robot

    sound = write_planar_robot(folder / "sound")
    files = [path.relative_to(sound) for path in sound.rglob("*") if path.suffix in (".urdf", ".yaml")]
    while True:
        robot = folder / "robot" / sound.name
        shutil.rmtree(folder / "robot", ignore_errors=True)
        shutil.copytree(sound, robot)
        name = rng.choice(files)
        (robot / name).write_bytes(mutated((robot / name).read_bytes(), rng))
        yield robot, lambda robot=robot: RobotModel.load(robot)


def tables(folder: Path, rng: random.Random) -> Iterator[Case]:
    """A record in a table."""
    from forcectl.runs.records.recorded import read_record
    from tests.runs.test_tune import record_file

    sound = record_file(folder, rows=1500).read_bytes()
    path = folder / "mutant.csv"
    while True:
        path.write_bytes(mutated(sound, rng))
        yield path, lambda: read_record(path)


def logs(folder: Path, rng: random.Random) -> Iterator[Case]:
    """The log of a run."""
    from forcectl.runs.logs import write_netcdf
    from forcectl.runs.records.recorded import read_record
    from forcectl.runs.run import run

    log = run({"station": {"fidelity": "OneDimensional"}, "duration": 0.3}).log
    write_netcdf(log, folder / "log.nc")
    sound = (folder / "log.nc").read_bytes()
    path = folder / "mutant.nc"
    while True:
        path.write_bytes(mutated(sound, rng))
        yield path, lambda: read_record(path)


KINDS = {"scenario": scenarios, "robot": robots, "table": tables, "log": logs}


def outcome(read: Callable[[], object]) -> tuple[str, str]:
    """What a file comes to in a word, and what is wrong with that."""
    from forcectl.errors import BadInputError

    try:
        read()
    except BadInputError as error:
        text = str(error)
        return "refused", "not one short line: " + text[:400] if "\n" in text or len(text) > 1000 else ""
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return "raised", f"{type(error).__name__}: {error}"[:400]
    return "used", ""


def run_all() -> None:
    parser = argparse.ArgumentParser(description="Random faults in scenarios, robots, tables and logs.")
    parser.add_argument("count", type=int, nargs="?", default=100, help="of each kind (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the faults (default 0)")
    parser.add_argument("--only", default="", help="kinds with commas between them (default all)")
    arguments = parser.parse_args()
    warnings.simplefilter("error", RuntimeWarning)  # of NumPy, about what was read
    kept = Path.cwd()
    for kind in arguments.only.split(",") if arguments.only else KINDS:
        seen: Counter[str] = Counter()
        begun = time.process_time()
        with tempfile.TemporaryDirectory(prefix="forcectl-mutated-") as folder:
            os.chdir(folder)
            cases = KINDS[kind](Path(folder), random.Random(arguments.seed))
            for number in range(arguments.count):
                path, read = next(cases)
                started = time.process_time()
                found, wrong = outcome(read)
                seen[found] += 1
                if time.process_time() - started > _LONGEST:
                    wrong = wrong or f"took {time.process_time() - started:.0f} s"
                if wrong:
                    seen["wrong"] += 1
                    name = f"{kind}-{arguments.seed}-{number}{path.suffix}"
                    (shutil.copytree if path.is_dir() else shutil.copy)(path, kept / name)
                    print(f"{name}: {wrong}", flush=True)
            os.chdir(kept)
        print(f"{kind}: {dict(seen)}, {time.process_time() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    run_all()
