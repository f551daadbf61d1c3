"""The command line: argv in, exit code out. What a command does lives elsewhere and is imported when it runs."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TextIO, TypeAlias

from robotd.setup.arguments import assignment, seconds, speed, tolerance
from robotd.setup.exit_codes import INTERNAL, INTERRUPTED, OK, USAGE, Usage, judge

if TYPE_CHECKING:
    from robotd.engine.replay import ReplayReport

KINDS = ("behaviour", "perceptor", "device", "bridge")

Args: TypeAlias = argparse.Namespace


class _Parser(argparse.ArgumentParser):
    """Raises `Usage` with a suggestion instead of leaving with code 2."""

    def error(self, message: str) -> NoReturn:
        raise Usage(f"{message}\nSee `{self.prog} --help`.")

    def check(self, argv: Sequence[str]) -> Args:
        """Parse; unknown options are answered with the nearest known one."""
        args, unknown = self.parse_known_args(argv)
        if unknown:
            word = unknown[0].partition("=")[0]
            if word in COMMANDS:
                self.error(f"a command goes first: robotd {word} ...")
            known = [option for action in self._actions for option in action.option_strings]
            self.error(f"{self.prog}: unknown argument {word!r}{_nearest(word, known)}")
        return args


def _nearest(word: str, known: Iterable[str]) -> str:
    import difflib

    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean `{near[0]}`?" if near else ""


# ------------------------------------------------------------------------------------------ arguments


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-v", "--verbose", action="count", default=0, help="say more; twice: also tracebacks and other libraries"
    )


def _layers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--sim", action="store_true", help="replace each device by its simulated twin in the file's simulation"
    )
    parser.add_argument(
        "--set",
        dest="sets",
        metavar="PATH=VALUE",
        action="append",
        default=[],
        type=assignment,
        help="set one value over the file and the environment (may be repeated)",
    )


def _run_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", metavar="FILE", help="the robot: a path, or the name of a shipped config")
    _layers(parser)
    parser.add_argument("--headless", action="store_true", help="no live view: one log line for each change")
    parser.add_argument("--arm", action="store_true", help="arm as soon as all needed devices are open")
    parser.add_argument("--duration", metavar="S", type=seconds, help="stop after this many seconds")
    parser.add_argument(
        "--speed", metavar="X", type=speed, help="pace of a simulation: 1 is real time, max is as fast as it can"
    )
    parser.add_argument("--record", metavar="FILE", type=Path, help="write every input of the run to this MCAP file")
    parser.add_argument("--log-json", action="store_true", help="log as JSON lines")
    parser.add_argument("--version", action="store_true", help="print the version")
    _common(parser)


def _file_argument(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    parser.add_argument("file", metavar="FILE", nargs=nargs, help="a path, or the name of a shipped config")


def _check_arguments(parser: argparse.ArgumentParser) -> None:
    _file_argument(parser)
    _layers(parser)
    _common(parser)


def _doctor_arguments(parser: argparse.ArgumentParser) -> None:
    _file_argument(parser, "?")
    parser.add_argument("--probe", action="store_true", help="open the devices too; motors are halted, never driven")
    parser.add_argument("--seconds", metavar="S", type=seconds, help="how long to keep them open (default: 4)")
    _common(parser)


def _device_arguments(parser: argparse.ArgumentParser) -> None:
    _file_argument(parser)
    parser.add_argument("name", metavar="NAME", help="a device of the config")
    parser.add_argument("what", metavar="listen|drive", choices=("listen", "drive"), help="what to do with it")
    parser.add_argument("--seconds", metavar="S", type=seconds, help="for how long (listen: 10; drive: 1, at most 10)")
    for option, unit in (("vx", "m/s"), ("vy", "m/s"), ("wz", "rad/s"), ("speed", "m/s"), ("steering", "rad")):
        parser.add_argument(f"--{option}", metavar="X", type=float, help=f"drive: {unit}")
    parser.add_argument("--fastest", metavar="V", type=seconds, help="drive: the limit in m/s (default: 0.2)")
    parser.add_argument("--yes", action="store_true", help="drive: do not ask whether the wheels are off the ground")
    _common(parser)


def _udev_arguments(parser: argparse.ArgumentParser) -> None:
    _file_argument(parser, "?")
    _common(parser)


def _new_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("kind", metavar="KIND", help=" | ".join(KINDS))
    parser.add_argument("name", metavar="NAME", help="lower snake case, for example wall_follow")
    parser.add_argument("--folder", type=Path, default=None, help="where to write it (default: here)")
    _common(parser)


def _replay_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path, help="a recording that --record wrote")
    parser.add_argument(
        "--assert", dest="demand", action="store_true", help="exit 70 unless every command comes out again"
    )
    parser.add_argument(
        "--tolerance", metavar="T", type=tolerance, default=0.0, help="largest difference that counts as equal"
    )
    _common(parser)


def _plot_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path, help="a recording that --record wrote")
    parser.add_argument(
        "-o", dest="out", metavar="PICTURE", type=Path, help=".png, .svg or .pdf (default: FILE with .png)"
    )
    _common(parser)


# ------------------------------------------------------------------------------------------- commands


def _run(args: Args) -> int:
    if args.version:
        from importlib.metadata import version

        return _print([f"robotd {version('robotd')}"])
    if args.config is None:
        raise Usage("which robot? Try `robotd --config jetbot.yaml --sim`.\nSee `robotd --help`.")
    if args.speed is not None and not args.sim:
        raise Usage("--speed is the pace of a simulation: add --sim, or leave it out")
    if args.record is not None and not args.record.resolve().parent.is_dir():
        raise Usage(f"--record {args.record}: there is no folder {args.record.resolve().parent}")
    from robotd.app import Options, run
    from robotd.engine.console import Console
    from robotd.engine.status_view import scale_of
    from robotd.setup.load import load_config

    loaded = load_config(args.config, sim=args.sim, sets=args.sets, env=os.environ)
    options = Options(
        sim=args.sim,
        headless=args.headless,
        arm=args.arm,
        duration_s=args.duration,
        speed=args.speed,
        record=args.record,
        verbosity=args.verbose,
        log_json=args.log_json,
    )
    with Console(
        headless=args.headless, verbosity=args.verbose, as_json=args.log_json, scale=scale_of(loaded.parts.robot)
    ) as console:
        return run(loaded, options, console)


def _check(args: Args) -> int:
    from robotd.setup.load import load_config

    loaded = load_config(args.file, sim=args.sim, sets=args.sets, env=os.environ, whole=True)
    parts = loaded.parts
    named = (
        ("device", len(parts.devices)),
        ("perceptor", len(parts.perceptors)),
        ("behaviour", len(parts.behaviours)),
        ("bridge", len(parts.bridges)),
    )
    counts = ", ".join(f"{count} {name}{'' if count == 1 else 's'}" for name, count in named if count)
    return _print([f"{loaded.file}: good ({counts or 'no devices'})"])


def _schema(args: Args) -> int:
    import json

    from robotd.setup.load import schema

    return _print([json.dumps(schema(), indent=2, ensure_ascii=False)])


def _plugins(args: Args) -> int:
    from robotd.setup.registry import installed

    rows = [("NAME", "GROUP", "DISTRIBUTION", "VERSION")]
    rows += [(p.name, p.group, p.distribution, p.version) for p in installed()]
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    return _print("  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def _doctor(args: Args) -> int:
    from robotd.setup.doctor.examine import PROBE_S, examine
    from robotd.setup.doctor.findings import exit_code, report
    from robotd.setup.doctor.probes import SystemProbes

    if args.file is None and args.probe:
        raise Usage("robotd doctor --probe opens the devices of a robot: name its FILE")
    if args.seconds is not None and not args.probe:
        raise Usage("robotd doctor --seconds is for how long devices are opened: add --probe, or leave it out")
    findings = examine(args.file, SystemProbes(), (args.seconds or PROBE_S) if args.probe else None)
    _print(report(findings))
    return exit_code(findings)


def _device(args: Args) -> int:
    from robotd.setup import bench
    from robotd.setup.load import load_config

    parts = load_config(args.file, env=os.environ).parts
    part = bench.part_named(parts, args.name)
    if args.what == "listen":
        return bench.run(bench.listen(part, parts.robot, args.seconds or 10.0, _say))
    given = {key: getattr(args, key) for key in ("vx", "vy", "wz", "speed", "steering")}
    command = bench.wanted_command(part, parts.robot, given)
    if not args.yes and not bench.is_allowed(sys.stdin.isatty(), input):
        return USAGE
    return bench.run(bench.drive(part, parts.robot, command, args.seconds or 1.0, _say, fastest_mps=args.fastest))


def _udev(args: Args) -> int:
    from robotd.setup import udev

    if args.file is None:
        return _print(udev.rules_for_all())
    from robotd.setup.doctor.probes import SystemProbes
    from robotd.setup.load import load_config

    parts = load_config(args.file, env=os.environ).parts
    return _print(udev.rules_for(args.file, udev.ports_of(parts.devices, SystemProbes())))


def _new(args: Args) -> int:
    if args.kind not in KINDS:
        raise Usage(f"robotd new {args.kind}: expected {', '.join(KINDS)}{_nearest(args.kind, KINDS)}")
    from robotd.setup.scaffold import new

    folder = new(args.kind, args.name, args.folder)
    return _print([f"wrote {folder}", f"next: cd {folder} && pip install -e .[test] && pytest"])


def _replay(args: Args) -> int:
    if not args.file.is_file():
        raise Usage(f"robotd replay: there is no file {args.file}")
    from robotd.engine.codec import RecordError
    from robotd.setup.recording import replay_file

    try:
        report = replay_file(args.file, tolerance=args.tolerance, demand=args.demand)
    except RecordError as error:
        raise Usage(f"robotd replay: {error}") from error
    _print(_replay_lines(report))
    passed = report.first_difference is None and report.compared > 0
    return INTERNAL if args.demand and not passed else OK


def _replay_lines(report: ReplayReport) -> list[str]:
    lines = [f"{report.compared} commands compared"]
    if report.first_difference is not None:
        lines.append(f"first difference: {report.first_difference}")
    elif report.compared:
        lines.append("all commands came out again")
    return lines + [str(note) for note in report.notes]


def _plot(args: Args) -> int:
    if not args.file.is_file():
        raise Usage(f"robotd plot: there is no file {args.file}")
    from robotd.engine.codec import RecordError
    from robotd.setup.plot import SUFFIXES, plot_file

    out: Path = args.out if args.out is not None else args.file.with_suffix(".png")
    if out.suffix.lower() not in SUFFIXES:
        raise Usage(f"robotd plot -o {out}: expected a name that ends in {', '.join(SUFFIXES)}")
    try:
        plot_file(args.file, out)
    except RecordError as error:
        raise Usage(f"robotd plot: {error}") from error
    return _print([f"wrote {out}"])


COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None], Callable[[Args], int]]] = {
    "check": ("read a config and print all its errors", _check_arguments, _check),
    "schema": ("print the JSON Schema of configs, for editors", _common, _schema),
    "plugins": ("list what is installed, without importing it", _common, _plugins),
    "doctor": ("look for what keeps a robot from working, and say how to mend it", _doctor_arguments, _doctor),
    "device": ("try one device on the bench: listen to it, or drive it for a moment", _device_arguments, _device),
    "udev": ("print rules for serial adapters: access, lasting names, no delay", _udev_arguments, _udev),
    "new": (f"write a new plugin: {', '.join(KINDS)}", _new_arguments, _new),
    "replay": ("run a recording again and compare the commands", _replay_arguments, _replay),
    "plot": ("draw a recording as one picture", _plot_arguments, _plot),
}


def _parser(name: str | None) -> _Parser:
    if name is not None:
        about, arguments, _ = COMMANDS[name]
        parser = _Parser(prog=f"robotd {name}", description=f"{about[0].upper()}{about[1:]}.", allow_abbrev=False)
        arguments(parser)
        return parser
    listed = "\n".join(f"  robotd {name:<8} {about}" for name, (about, _, _) in COMMANDS.items())
    parser = _Parser(
        prog="robotd",
        description="Drive one robot from one file: its devices, or their simulated twins.",
        epilog=f"other commands:\n{listed}\n\nexit codes: 0 good, 64 wrong command line, 69 device not there, "
        "70 fault of robotd,\n75 try again, 77 no permission, 78 wrong config",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    _run_arguments(parser)
    return parser


def parse(argv: Sequence[str]) -> tuple[Callable[[Args], int], Args]:
    """The function to call and its arguments. Raises Usage; SystemExit(0) after `--help`."""
    if argv and not argv[0].startswith("-"):
        word = argv[0]
        if word in COMMANDS:
            return COMMANDS[word][2], _parser(word).check(argv[1:])
        if word.endswith((".yaml", ".yml")):
            raise Usage(f"robotd starts a robot with `robotd --config {word}`")
        raise Usage(f"robotd: no command {word!r}{_nearest(word, COMMANDS)}\nSee `robotd --help`.")
    return _run, _parser(None).check(argv)


# ------------------------------------------------------------------------------------------- the door


def _print(lines: Iterable[str]) -> int:
    """To standard output; a reader that went away (`| head`) is no error."""
    try:
        for line in lines:
            print(line)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return OK


def _say(line: str) -> None:
    _print([line])


def _terminated(signum: int, frame: object) -> None:
    raise KeyboardInterrupt


def main(argv: Sequence[str] | None = None, *, stderr: TextIO | None = None) -> int:
    """Run one command and return its exit code; never raises but for `--help` (SystemExit 0)."""
    words = list(sys.argv[1:] if argv is None else argv)
    err = stderr if stderr is not None else sys.stderr
    stopped_well, verbosity = False, 0
    try:
        # the running robot installs its own handlers; this one serves before and after
        signal.signal(signal.SIGTERM, _terminated)
        command, args = parse(words)
        stopped_well, verbosity = command is _run, args.verbose
        return command(args)
    except KeyboardInterrupt:
        # a robot that is asked to stop has done its work; a check that is interrupted has not
        return OK if stopped_well else INTERRUPTED
    except Exception as error:
        if verbosity >= 2:
            traceback.print_exc(file=err)
        code, sentence = (USAGE, str(error)) if isinstance(error, Usage) else judge(error)
        print(sentence, file=err)
        return code


if __name__ == "__main__":
    sys.exit(main())
