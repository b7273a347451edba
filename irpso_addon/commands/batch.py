"""``batch LIST``: runs the recoveries of a list one after another; a restart continues."""

from __future__ import annotations

import itertools
import json
import sys
import time
import traceback
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..blender.images import decode
from ..calibration.rigs.apply import apply_steps
from ..calibration.rigs.rig import read_rig
from ..capture.formats.toml_file import load_toml
from ..cluster.transport import joined
from ..core.errors import CheckpointError, InputError, IrpsoError
from ..core.files import write_json
from ..core.steps import run_steps
from ..pipeline.drive import CHECKPOINT
from ..pipeline.lock import locked_folder
from ..pipeline.ranks import leave_with_error
from ..results.report import plain
from ..results.write import REPORT, check_output_folder
from ..solver.state.checkpoint import check_replaceable
from . import recover
from .options.origin import foreign_path, has_same_others, is_same_origin, name_of, origin_of
from .options.values import OF_ASSETS, numbers_of_text, silent

_PATHS = ("capture", "blend", "ground_truth", "asset")  # keys whose values are relative to the list
_NAMES_OR_PATHS = ("model", "preset")
_REPEATED = ("set", "fixed", "occluder", "tag")  # options that a list repeats; it is one value of any other
_SWITCHED_OFF = ("preview", "shadows")  # keys whose false is an option, --no-…
_BATCH_OPTIONS = ("output", "resume", "json", "quiet", "help", "dry_run")
# Defaults that do not apply to cards, or to meshes; OF_ASSETS apply to jobs with an asset.
_OF_MESHES = ("resolution", "object", "slots", "occluder", "shadows", "no_shadows")
_OF_CARDS = ("distance", "crop", "corners", "card_width")
_RIG = "rig"  # the word before a rig, at the end of a job's words
_SUMMARY = "batch.json"  # of all jobs, in the output folder
_AGAIN = "start the batch again to continue"
_CHECKPOINT_SECONDS = 60.0  # default of --checkpoint-every
_REPORTED = (
    "texels", "seconds", "residual", "ground_truth", "relighting_psnr_db", "relighting_highlights_psnr_db", "warnings",
)  # fmt: skip

Parse = Callable[[Sequence[str]], Namespace]


@dataclass(frozen=True)
class Row:
    """One job of a list. words: its command line, without the options that a batch adds.

    listed: the same words with paths as in the list, which identify the job even if the list has moved. rig: applied to
    the job's capture, which is then a folder of photographs. former_name: default name of the job in version 0.1.0;
    None for a job with a name. others: other files that it reads, by their place in the list, as its mesh.
    """

    name: str
    words: tuple[str, ...]
    listed: tuple[str, ...]
    rig: Path | None = None
    former_name: str | None = None
    others: tuple[Path, ...] = ()

    def folder(self, output: Path) -> Path:
        """Return the folder of the job's result."""
        return output / self.name

    def state_file(self, output: Path) -> Path:
        """Return the file of the job's state."""
        return output / f"{self.name}.json"

    def capture(self, output: Path) -> Path:
        """Return the folder of the job's capture under its rig."""
        return output / f"{self.name}_capture"

    @property
    def photographs(self) -> Path:
        """The job's capture; with a rig the folder of its photographs."""
        return Path(self.words[1])

    @property
    def places(self) -> list[str]:
        """Names of what the job writes into the batch's folder, in lower case: not all systems tell cases apart."""
        here = Path()
        written = [self.folder(here), self.state_file(here), *[self.capture(here)] * (self.rig is not None)]
        return [path.name.lower() for path in written]


def run(options: Namespace) -> dict:
    """Run the unfinished jobs of a list and write one report. A failed job does not stop the others."""
    ranks = joined()
    if ranks is not None:
        error = InputError("batch: runs in one process; start it without mpirun, once for each --only NAME")
        return leave_with_error(ranks, options, error)
    output = check_output_folder(options.output)
    listed = read_list(Path(options.list), options.parse)
    jobs = _as_before(listed, output)
    if options.only is not None:
        chosen = [job for job, now in zip(jobs, listed, strict=True) if options.only in (job.name, now.name)]
        if not chosen:
            names = ", ".join(job.name for job in listed)
            raise InputError(f"--only {options.only}: {options.list} has no such job; choose one of {names}")
        _check_replaces_nothing(chosen, output)
        return _outcome([_run_job(chosen[0], output, options)], None, options)
    with locked_folder(output):
        _check_replaces_nothing(jobs, output, _SUMMARY)
        states = [_run_job(job, output, options) for job in jobs]
        return _outcome(states, output / _SUMMARY, options)


def _check_replaces_nothing(jobs: Sequence[Row], output: Path, *summaries: str) -> None:
    """Raise InputError if a state file or summary would replace a file that no batch wrote."""
    files = {job.state_file(output): ("name", {"words", "state"}) for job in jobs}
    files |= {output / summary: ("done", {"failed", "jobs"}) for summary in summaries}
    for file, (first, others) in files.items():
        if not _is_own(file, first, others):
            raise InputError(f"{file}: would be replaced, but no batch wrote it; choose another -o, or move it")


def _is_own(file: Path, first: str, others: set[str]) -> bool:
    """Return whether a file is missing, one of ours with these other keys, or one with this first key that is cut."""
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        return True
    except (OSError, UnicodeDecodeError):
        return False
    try:
        table = json.loads(text)
    except ValueError:
        return text.startswith(f'{{\n  "{first}": '[: len(text)])
    return isinstance(table, dict) and others <= set(table)


def read_list(path: Path, parse: Parse) -> list[Row]:
    """Return the jobs of a TOML list. Raises InputError naming the list and the job if one is invalid.

    [defaults] holds options of ``recover`` for all jobs, each [[job]] its own, by their long names with _ for -. A job
    has a capture and may have a name. parse: the command line's parser.
    """
    table = load_toml(path)
    rows, defaults = table.get("job"), table.get("defaults", {})
    if set(table) - {"job", "defaults"} or not isinstance(defaults, dict):
        raise InputError(f"{path}: may hold [defaults] and [[job]] tables, and nothing else")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path}: lists no job; add one [[job]] with a capture for each")
    jobs = [_job(_with_defaults(row, defaults), number, path, parse) for number, row in enumerate(rows, 1)]
    names = [job.name.lower() for job in jobs]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{path}: two jobs are called '{twice}'; give them names that differ")
    owners = {_SUMMARY: "batch itself"}
    for job in jobs:
        if taken := next((place for place in job.places if place in owners), None):
            raise InputError(
                f"{path}: job {job.name}: would write {taken}, as {owners[taken]} does; give it another name"
            )
        owners |= dict.fromkeys(job.places, f"job {job.name}")
    return jobs


def _as_before(jobs: list[Row], output: Path) -> list[Row]:
    """Return the jobs; one that a former version has begun here under its former default name keeps that name."""
    kept = list(jobs)
    for number, job in enumerate(jobs):
        if not job.former_name or job.state_file(output).exists():
            continue
        former = replace(job, name=job.former_name)
        others = {_SUMMARY, *(place for other in kept if other is not job for place in other.places)}
        state = _state(former.state_file(output))
        same = state.get("words") == list(job.listed) and not _is_elsewhere(former, state, output)
        if same and others.isdisjoint(former.places):
            kept[number] = former
    return kept


def _with_defaults(row: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    """Return a job with the defaults: a card without those of meshes, a mesh without those of cards, and so on."""
    if "shadows" in row:  # the opposite of no_shadows
        defaults = {key: value for key, value in defaults.items() if key != "no_shadows"}
    merged = {**defaults, **row}
    card = not merged.get("blend") and not str(merged.get("capture", "")).lower().endswith(".blend")
    others = (*(_OF_MESHES if card else _OF_CARDS), *(() if merged.get("asset") else OF_ASSETS))
    return {key: value for key, value in merged.items() if key not in others or key in row}


def _job(row: dict[str, Any], number: int, path: Path, parse: Parse) -> Row:
    where = f"{path}: job {row.get('name', number)}"
    if not isinstance(row.get("capture"), str):
        raise InputError(f'{where}: has no capture; add capture = "folder"')
    name = row.get("name", name_of(path.parent / row["capture"]))
    if not isinstance(name, str) or not name or Path(name).name != name or name.startswith("."):
        raise InputError(f"{where}: give it a name that a folder can have")
    if reserved := [key for key in _BATCH_OPTIONS if key in row]:
        raise InputError(f"{where}: {reserved[0]} is not an option of jobs; give it to batch itself")
    rig = row.pop("rig", None)
    if rig is not None and not isinstance(rig, str):
        raise InputError(f'{where}: rig must be a text, as in rig = "folder"')
    words, listed = (_command(row, place) for place in (path, None))
    try:
        for key in [key for key, value in row.items() if value is False and key not in _SWITCHED_OFF]:
            _check_known(_option(key), parse)
        parse([*words, "-o", name])
    except InputError as error:
        raise InputError(f"{where}: {str(error).partition('; see ')[0]}; keys are the options of recover") from error
    former, others = None if "name" in row else Path(row["capture"]).stem, tuple(_others(row, path.absolute()))
    if rig is None:
        return Row(name, tuple(words), tuple(listed), None, former, others)
    return Row(name, tuple(words), (*listed, _RIG, rig), path.parent / rig, former, others)


def _others(row: dict[str, Any], path: Path) -> Iterator[Path]:
    """Yield the files besides the capture that a job reads, where the list names them by their place beside it."""
    for key, value in row.items():
        for one in value if isinstance(value, list) else [value]:
            if key in ("name", "capture", "asset") or not isinstance(one, str):
                continue
            if (word := _beside(path, key, one)) != one:
                yield Path(word.partition("=")[2] if key == "fixed" else word)


def _check_known(option: str, parse: Parse) -> None:
    """Raise InputError unless ``recover`` has this option, of whatever value."""
    try:
        parse(["recover", "capture", "-o", "out", option])
    except InputError as error:  # also of a known one, whose value is missing
        if "unrecognized" in str(error):
            raise


def _command(row: dict[str, Any], path: Path | None) -> list[str]:
    """Return the words of a job. path: the list, which paths are relative to; None to leave them unchanged."""
    words = ["recover", _beside(path, "capture", row["capture"])]
    for key, value in row.items():
        if key not in ("name", "capture"):
            words += _words(key, value, path)
    return words if "checkpoint_every" in row else [*words, "--checkpoint-every", f"{_CHECKPOINT_SECONDS:g}"]


def _words(key: str, value: Any, path: Path | None) -> list[str]:
    """Return one option as words of a command line. A list repeats the option, or is its values with commas."""
    if isinstance(value, bool):
        chosen = [] if key == "shadows" else [_option(key)]  # predicted without an option
        return chosen if value else [f"--no-{key}"] * (key in _SWITCHED_OFF)
    if isinstance(value, list):
        if key in _REPEATED:
            return [word for one in value for word in _words(key, one, path)]
        value = ",".join(map(str, value))
    word = _beside(path, key, str(value))
    return [f"{_option(key)}={word}"] if word.startswith("-") else [_option(key), word]


def _option(key: str) -> str:
    return f"--{key.replace('_', '-')}"


def _beside(path: Path | None, key: str, value: str) -> str:
    """Return an option's value; paths in it are joined to the list's folder."""
    if path is None:
        return value
    if key in _PATHS or (key in _NAMES_OR_PATHS and value.endswith(".toml")):
        return str(path.parent / value)
    name, equals, file = value.partition("=")
    if key == "fixed" and equals and numbers_of_text(file) is None:
        return f"{name}={path.parent / file.strip()}"
    return value


def _run_job(job: Row, output: Path, options: Namespace) -> dict[str, Any]:
    """Run a job unless it is done; return the contents of its state file."""
    folder, file = job.folder(output), job.state_file(output)
    former = _state(file)
    moved = _is_elsewhere(job, former, output)
    same = former.get("words") == list(job.listed) and not moved
    if same and former.get("state") == "done" and (folder / REPORT).is_file():
        _say(options, f"{job.name}: done before")
        return former
    if reason := _refusal(job, former, moved, output):
        return _failed(job, reason)  # the former state stays, to tell this again
    capture = job.capture(output)
    resume = same and (folder / CHECKPOINT).is_file()
    _say(options, f"{job.name}: {'continues' if resume else 'starts'}")
    origin = origin_of(job.photographs, job.rig, job.others, output)
    state = {"name": job.name, "words": list(job.listed), "origin": origin, "state": "begun"}
    write_json(file, plain(state))
    words = [*job.words, "-o", str(folder), *["--resume"] * resume, *["--quiet"] * silent(options)]
    started, interrupted = time.perf_counter(), False
    try:
        if job.rig is not None:
            words[1] = str(_under_rig(job.rig, Path(words[1]), capture, options))
        try:
            report = recover.run(options.parse(words))
        except CheckpointError as error:  # damaged, or of other options, photographs or another version
            moved = _move_damaged(folder / CHECKPOINT)
            _say(options, f"{job.name}: starts again ({error}{moved})")
            report = recover.run(options.parse([word for word in words if word != "--resume"]))
        interrupted = report.get(recover.INTERRUPTED, False)
        state |= {"state": "done", "result": {key: report[key] for key in _REPORTED if key in report}}
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_AGAIN) from None
    except (InputError, MemoryError) as error:
        state |= _failed(job, " ".join(str(error).splitlines()))
    except IrpsoError:  # without a GPU no job can run
        raise
    except Exception as error:  # noqa: BLE001  a fault of one job must not stop the others
        traceback.print_exc()
        state |= _failed(job, f"{type(error).__name__}: {error}")
    state["took"] = round(time.perf_counter() - started, 1)
    write_json(file, plain(state))
    if interrupted:
        raise KeyboardInterrupt(_AGAIN)
    return state


def _move_damaged(path: Path) -> str:
    """Rename a job's checkpoint that no recovery replaces; return what to tell of it, or ""."""
    try:
        check_replaceable(path)
    except CheckpointError:
        names = (f"{path.stem}.damaged{f'_{n}' * (n > 0)}{path.suffix}" for n in itertools.count())
        moved = next(path.with_name(name) for name in names if not path.with_name(name).exists())
        path.rename(moved)
        return f"; it is {moved.name} now"
    return ""


def _photographs(listed: Sequence[str]) -> list[str]:
    """Return the words of a job, from its list, that determine its capture: photographs and rig."""
    return [listed[1], *(listed[-2:] if listed[-2] == _RIG else ())]


def _is_elsewhere(job: Row, former: dict[str, Any], output: Path) -> bool:
    """Return whether a former job of this name had other photographs, or with the same words other files."""
    origin = former.get("origin")
    if not is_same_origin(origin, job.photographs, job.rig, output):
        return True
    return former.get("words") == list(job.listed) and not has_same_others(origin, job.others, output)


def _refusal(job: Row, former: dict[str, Any], moved: bool, output: Path) -> str | None:
    """Return why a job must not replace or use what is in the batch's folder, if so. moved: of ``_is_elsewhere``."""
    capture, folder = job.capture(output), job.folder(output)
    made_of = _photographs(former["words"]) if "words" in former else None
    if job.rig is not None and capture.is_dir() and (moved or made_of != _photographs(job.listed)):
        return f"{capture}: may be of other photographs or another rig; delete or rename it"
    if moved and any((folder / written).is_file() for written in (REPORT, CHECKPOINT)):
        of = foreign_path(former["origin"], job.photographs, job.rig, job.others)
        state = job.state_file(output)
        return f"{folder}: is of {of}; choose another name or -o, or delete {state} to replace it"
    return None


def _failed(job: Row, error: str) -> dict[str, Any]:
    """Print the error of a job; return the contents of its state file."""
    sys.stderr.write(f"irpso: job '{job.name}' failed: {error}\n")
    return {"name": job.name, "words": list(job.listed), "state": "failed", "error": error}


def _under_rig(rig: Path, photographs: Path, capture: Path, options: Namespace) -> Path:
    """Return the folder of the photographs' capture under a rig; write it unless it exists."""
    if not capture.is_dir():
        applied = run_steps(apply_steps(read_rig(rig), photographs, capture, decoder=decode))
        for warning in (*applied.left_out, *applied.warnings):
            _say(options, f"{capture.name}: {warning}")
    return capture


def _outcome(states: list[dict[str, Any]], file: Path | None, options: Namespace) -> dict:
    """Write and return the report of all jobs."""
    failed = [state["name"] for state in states if state["state"] == "failed"]
    report = {"done": len(states) - len(failed), "failed": failed, "jobs": states}
    if file is not None:
        write_json(file, plain(report))
    failures = f"; failed: {', '.join(failed)}" if failed else ""
    _say(options, f"{report['done']} of {len(states)} done{failures}")
    return report | {"exit_code": InputError.exit_code if failed else 0}


def _state(file: Path) -> dict[str, Any]:
    """Return the contents of a state file; {} if it is missing or damaged, so that its job starts again."""
    try:
        state = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return state if isinstance(state, dict) else {}


def _say(options: Namespace, text: str) -> None:
    if not silent(options):
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()
