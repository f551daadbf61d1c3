"""The command line as tables: argv in; exit code, words, and what the robot was started with out."""

from __future__ import annotations

import errno
import io
import math
import os
import re
import signal
import subprocess
import sys
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from robotd import cli
from robotd.authoring.device import DeviceLost, DeviceMisconfigured, DeviceUnavailable
from robotd.engine.devices import Unavailable
from robotd.engine.parts import Parts
from robotd.setup.problems import ConfigError, Problem
from robotd.setup.scaffold import ScaffoldError
from robotd.world.robot import Limits, Robot


@dataclass
class Loaded:
    parts: Parts
    merged: dict[str, Any]
    file: Path


@dataclass
class Report:
    compared: int = 12
    first_difference: object = None
    comparable_until: object = None
    notes: tuple[str, ...] = ()


@dataclass
class Doors:
    """What stands behind the command line, faked: `calls` says how it was opened, `then` what it does."""

    calls: list[tuple[str, Any]] = field(default_factory=list)
    then: Callable[[], Any] = lambda: 0
    report: Report = field(default_factory=Report)
    refusal: str = ""

    def load_config(self, file: str, *, sim: bool, sets: Any, env: Any, whole: bool = False) -> Loaded:
        self.calls.append(("load", (file, sim, tuple(sets))))
        if file == "wrong.yaml":
            raise self.wrong()
        return Loaded(Parts(Robot(limits=Limits(vx_mps=0.3)), ()), {}, Path(file))

    def run(self, loaded: Loaded, options: Any, view: Any) -> int:
        self.calls.append(("run", options))
        assert callable(view.update)
        return int(self.then())

    def replay(self, path: Path, *, tolerance: float, demand: bool) -> Report:
        self.calls.append(("replay", (path.name, tolerance, demand)))
        return self.report

    def new(self, kind: str, name: str, folder: Path | None) -> Path:
        self.calls.append(("new", (kind, name, folder)))
        if self.refusal:
            raise ScaffoldError(self.refusal)
        return Path(name)

    def wrong(self) -> Exception:
        place = ("wrong.yaml", 3, 5, "guard.latency")
        return ConfigError([Problem(*place, "is unknown", "did you mean 'latency_s'?")])


@dataclass
class Options:
    """The names that the command line and the app agree on."""

    sim: bool
    headless: bool
    arm: bool
    duration_s: float | None
    speed: float | None
    record: Path | None
    verbosity: int
    log_json: bool


def module(name: str, **members: Any) -> types.ModuleType:
    made = types.ModuleType(name)
    for key, value in members.items():
        setattr(made, key, value)
    return made


@pytest.fixture
def doors(monkeypatch: pytest.MonkeyPatch) -> Doors:
    behind = Doors()
    monkeypatch.setattr("robotd.setup.load.load_config", behind.load_config)
    monkeypatch.setattr("robotd.setup.load.schema", lambda: {"title": "robotd"})
    for made in (
        module("robotd.app", Options=Options, run=behind.run),
        module("robotd.setup.recording", replay_file=behind.replay),
    ):
        monkeypatch.setitem(sys.modules, made.__name__, made)
    monkeypatch.setattr("robotd.setup.scaffold.new", behind.new)
    return behind


@pytest.fixture(autouse=True)
def handlers() -> Any:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


# ---------------------------------------------------------------------------------------- starting


BARE = Options(False, False, False, None, None, None, 0, False)


@pytest.mark.parametrize(
    ("argv", "changed"),
    [
        ("--config a.yaml", {}),
        ("--config=a.yaml --sim", {"sim": True}),
        ("--sim --config a.yaml --speed max", {"sim": True, "speed": math.inf}),
        ("--sim --config a.yaml --speed 2.5", {"sim": True, "speed": 2.5}),
        ("--config a.yaml --arm --headless", {"arm": True, "headless": True}),
        ("--config a.yaml --duration 1.5", {"duration_s": 1.5}),
        ("--config a.yaml --record out.mcap", {"record": Path("out.mcap")}),
        ("--config a.yaml -vv --log-json", {"verbosity": 2, "log_json": True}),
        ("--config a.yaml -v --verbose", {"verbosity": 2}),
    ],
)
def test_options_reach_the_app(doors: Doors, argv: str, changed: dict[str, Any]) -> None:
    assert cli.main(argv.split()) == 0
    assert doors.calls[-1] == ("run", Options(**{**vars(BARE), **changed}))


def test_sets_are_handed_on_in_order(doors: Doors) -> None:
    assert cli.main(["--config", "a.yaml", "--set", "a.b=1", "--set", "c=x=y", "--sim"]) == 0
    assert doors.calls[0] == ("load", ("a.yaml", True, ("a.b=1", "c=x=y")))


@pytest.mark.parametrize("code", [0, 69, 70, 75, 77, 78])
def test_the_exit_code_of_the_app_is_the_exit_code(doors: Doors, code: int) -> None:
    doors.then = lambda: code
    assert cli.main(["--config", "a.yaml"]) == code


# --------------------------------------------------------------------------------------- wrong usage


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ("", "robotd --config jetbot.yaml --sim"),
        ("chek a.yaml", "no command 'chek'; did you mean `check`?"),
        ("replya a.mcap", "did you mean `replay`?"),
        ("zzz", "no command 'zzz'\n"),
        ("jetbot.yaml", "robotd --config jetbot.yaml"),
        ("--config a.yaml check", "a command goes first: robotd check"),
        ("-v check a.yaml", "a command goes first: robotd check"),
        ("--config", "--config"),
        ("--conf a.yaml", "unknown argument '--conf'; did you mean `--config`?"),
        ("--config a.yaml --simm", "unknown argument '--simm'; did you mean `--sim`?"),
        ("--config a.yaml --headles=1", "did you mean `--headless`?"),
        ("--config a.yaml --speed 2", "add --sim"),
        ("--config a.yaml --sim --speed fast", "a factor above 0 such as 2.5, or max, got 'fast'"),
        ("--config a.yaml --sim --speed 0", "a factor above 0"),
        ("--config a.yaml --sim --speed nan", "a factor above 0"),
        ("--config a.yaml --duration -1", "seconds above 0, got '-1'"),
        ("--config a.yaml --duration ten", "seconds above 0, got 'ten'"),
        ("--config a.yaml --duration inf", "seconds above 0"),
        ("--config a.yaml --set a.b", "expected path=value"),
        ("--config a.yaml --set =3", "expected path=value"),
        ("--config a.yaml --record no/such/folder/a.mcap", "there is no folder"),
        ("check", "FILE"),
        ("check a.yaml b.yaml", "unknown argument 'b.yaml'"),
        ("check a.yaml --arm", "unknown argument '--arm'"),
        ("new behavior wander", "did you mean `behaviour`?"),
        ("new behaviour", "NAME"),
        ("replay", "FILE"),
        ("replay no_such.mcap", "there is no file no_such.mcap"),
        ("replay a --tolerance -1", "a difference of 0 or more"),
        ("plugins all", "unknown argument 'all'"),
    ],
)
def test_wrong_usage(doors: Doors, argv: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(argv.split()) == 64
    out, err = capsys.readouterr()
    assert words in err
    assert out == ""
    assert "Traceback" not in err
    assert doors.calls == []


# ---------------------------------------------------------------------------------------------- errors


def _from(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (DeviceMisconfigured("lidar: no such model"), 78, "lidar: no such model\n"),
        (DeviceLost("lidar: unplugged"), 69, "lidar: unplugged\n"),
        (Unavailable("lidar: no such port"), 69, "lidar: no such port\n"),
        (_from(Unavailable("lidar"), _from(DeviceUnavailable("x"), PermissionError(13, "no"))), 77, "lidar\n"),
        (_from(DeviceUnavailable("lidar: busy"), BlockingIOError(11, "busy")), 75, "lidar: busy\n"),
        (_from(DeviceUnavailable("lidar: busy"), OSError(errno.EBUSY, "busy")), 75, "lidar: busy\n"),
        (PermissionError(13, "Permission denied", "a.yaml"), 77, "a.yaml: Permission denied\n"),
        (FileNotFoundError(2, "No such file", "map.yaml"), 69, "map.yaml: No such file\n"),
        (OSError("odd"), 69, "odd\n"),
        (BlockingIOError(11, "held", "robot.lock"), 75, "robot.lock: held\n"),
        (ExceptionGroup("g", [Unavailable("a"), DeviceMisconfigured("b"), Unavailable("a")]), 78, "a\nb\n"),
        (ZeroDivisionError("by zero"), 70, "ZeroDivisionError: by zero (add -vv for the traceback)\n"),
    ],
)
def test_errors_are_sentences(
    doors: Doors, error: Exception, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> int:
        raise error

    doors.then = fail
    assert cli.main(["--config", "a.yaml"]) == code
    err = capsys.readouterr().err
    assert err.endswith(words)
    assert "Traceback" not in err


def test_traceback_where_wanted(doors: Doors, capsys: pytest.CaptureFixture[str]) -> None:
    doors.then = lambda: 1 // 0
    assert cli.main(["--config", "a.yaml", "-vv"]) == 70
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("argv", ["--config wrong.yaml", "check wrong.yaml"])
def test_a_wrong_config(doors: Doors, argv: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(argv.split()) == 78
    words = "wrong.yaml:3:5: guard.latency: is unknown; did you mean 'latency_s'?\n"
    assert capsys.readouterr() == ("", words)


def test_a_plugin_that_cannot_be_written(doors: Doors, capsys: pytest.CaptureFixture[str]) -> None:
    doors.refusal = "choose another name"
    assert cli.main(["new", "device", "Lidar"]) == 64
    assert capsys.readouterr().err == "choose another name\n"


@pytest.mark.parametrize(("argv", "code"), [("--config a.yaml", 0), ("check a.yaml", 130)])
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_being_asked_to_stop(argv: str, code: int, stop: signal.Signals, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*args: Any, **options: Any) -> Any:
        os.kill(os.getpid(), stop)
        pytest.fail("the signal did not arrive")

    monkeypatch.setitem(sys.modules, "robotd.app", module("robotd.app", Options=Options, run=interrupted))
    monkeypatch.setattr("robotd.setup.load.load_config", interrupted)
    assert cli.main(argv.split()) == code


# -------------------------------------------------------------------------------------------- commands


@pytest.mark.parametrize(
    ("argv", "lines"),
    [
        ("check a.yaml", ["a.yaml: good"]),
        ("check a.yaml --sim --set a=1", ["a.yaml: good"]),
        ("schema", ["{", '  "title": "robotd"', "}"]),
        ("new device thermal", ["wrote thermal", "next: cd thermal && pip install -e .[test] && pytest"]),
        ("--version", ["robotd 0.1.0"]),
    ],
)
def test_commands_print(doors: Doors, argv: str, lines: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(argv.split()) == 0
    out, err = capsys.readouterr()
    assert [line.partition(" (")[0] for line in out.splitlines()] == lines
    assert err == ""


@pytest.mark.parametrize(
    ("argv", "difference", "code", "words"),
    [
        ("", None, 0, "all commands came out again"),
        ("--assert", None, 0, "all commands came out again"),
        ("", "turn 7", 0, "first difference: turn 7"),
        ("--assert", "turn 7", 70, "first difference: turn 7"),
        ("--assert --tolerance 1e-9", "turn 7", 70, "first difference: turn 7"),
    ],
)
def test_replay(
    doors: Doors,
    tmp_path: Path,
    argv: str,
    difference: str | None,
    code: int,
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recording = tmp_path / "run.mcap"
    recording.touch()
    doors.report = Report(first_difference=difference, notes=("another numpy",))
    assert cli.main(["replay", str(recording), *argv.split()]) == code
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "12 commands compared"
    assert words in out
    assert out[-1] == "another numpy"


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        cli.main(["--help"])
    assert left.value.code == 0
    out = capsys.readouterr().out
    assert all(f"robotd {name}" in out for name in cli.COMMANDS)


@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_help_of_each_command(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        cli.main([name, "--help"])
    assert left.value.code == 0
    assert f"usage: robotd {name}" in capsys.readouterr().out


def test_a_reader_that_goes_away_is_no_error() -> None:
    code = "from robotd.cli import _print; import sys; sys.exit(_print('x' * 100 for _ in range(10000)))"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == b""
    assert process.returncode == 0


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from robotd.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'pydantic', 'asyncio', 'cv2', 'aiohttp', 'ruamel'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_plugins_are_listed_without_being_imported() -> None:
    code = (
        "import sys\n"
        "from robotd.cli import main\n"
        "code = main(['plugins'])\n"
        "print(code, sorted(m for m in sys.modules if m.startswith(('robotd_plugins', 'robotd_devices'))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert lines[0].split() == ["NAME", "GROUP", "DISTRIBUTION", "VERSION"]
    assert ["ld19", "robotd.devices", "robotd", "0.1.0"] in [line.split() for line in lines]
    assert lines[-1] == "0 []"


GOOD = """\
robot:
  kinematics: {type: differential, track_m: 0.12}
  footprint_m: [[0.1, 0.1], [0.1, -0.1], [-0.1, -0.1], [-0.1, 0.1]]
guard:
  zones: {off: a test}
"""


@pytest.mark.parametrize(
    ("text", "argv", "code", "words"),
    [
        (GOOD, "", 0, "robot.yaml: good (no devices)\n"),
        (GOOD, "--set act_hz=20", 0, "robot.yaml: good (no devices)\n"),
        (GOOD, "--set act_hz=fast", 78, "--set act_hz: act_hz"),
        (
            GOOD.replace("track_m", "trackm"),
            "",
            78,
            "robot.yaml:2:36: robot.kinematics.trackm: unknown key; did you mean 'track_m'",
        ),
        (GOOD + "robot: {}\n", "", 78, "robot.yaml:6:1"),
    ],
)
def test_check_on_real_files(
    tmp_path: Path, text: str, argv: str, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(text)
    assert cli.main(["check", str(file), *argv.split()]) == code
    out, err = capsys.readouterr()
    assert words in (err if code else out)
    assert (out if code else err) == ""


def test_a_config_that_may_not_be_read(capsys: pytest.CaptureFixture[str]) -> None:
    error = _from(ConfigError([Problem("a.yaml", None, None, "", "cannot be read")]), PermissionError(13, "no"))
    assert cli.judge(error) == (77, "a.yaml: cannot be read")


def test_the_page_about_the_command_line_names_every_option() -> None:
    page = (Path(__file__).parents[2] / "docs" / "cli.md").read_text()
    synopsis = page.partition("```\n")[2].partition("```")[0]
    said = set(re.findall(r"--[a-z-]+|(?<= \[)-[vo]", synopsis))
    known = {
        option
        for name in (None, *cli.COMMANDS)
        for action in cli._parser(name)._actions
        for option in action.option_strings
    }
    assert said == known - {"-h", "--help", "--verbose", "--version"}
    assert all(re.search(rf"^robotd {name}\b", synopsis, re.M) for name in cli.COMMANDS)


def test_errors_can_go_elsewhere(doors: Doors) -> None:
    err = io.StringIO()
    assert cli.main(["zzz"], stderr=err) == 64
    assert "no command 'zzz'" in err.getvalue()
