"""Common parts of the commands: one-line errors, exit codes, one thread, JSON output."""

from __future__ import annotations

import argparse
import difflib
import itertools
import math
import os
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from softdyn.commands.working import doing, working
from softdyn.files import read_toml as read_toml  # for the commands

if TYPE_CHECKING:
    from softdyn import SoftModel
    from softdyn.description.robot import Robot
    from softdyn.design import Design
    from softdyn.validation import Log
    from softdyn.view.live.channel import Channel
    from softdyn.view.page import Page

PASSED, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
Arguments = argparse.Namespace
BLOCK = "a <softdyn> block for a URDF that has none"
Command = Callable[[Arguments], int]


class Parser(argparse.ArgumentParser):
    """An argument parser with errors on one line, which accepts negative numbers."""

    def __init__(self, description: str | None, epilog: str | None = None) -> None:
        layout = argparse.RawDescriptionHelpFormatter
        super().__init__(description=description, epilog=epilog, formatter_class=layout)
        # argparse would take -1e-3 for an option, because its own pattern has no exponents.
        self._negative_number_matcher = re.compile(r"-\.?\d|-inf|-nan", re.IGNORECASE)
        self.outputs: list[str] = []
        self._unused: list[tuple[list[str], Callable[[Arguments], bool], str]] = []
        self._given: set[str] = set()
        self._settings: list[str] = []
        self._instead: tuple[str, tuple[argparse.Action, ...], Any] | None = None

    def output(self, name: str, metavar: str, help: str, *, required: bool = False) -> None:
        """Add an option for an output file, which `check_outputs` will check."""
        added = self.add_argument(name, metavar=metavar, help=help, required=required)
        self.outputs.append(added.dest)

    def option(self, name: str, kind: Callable, metavar: str, help: str, default: Any) -> None:
        """Add an option with a default that its help states."""
        shown = f"{help} (default: %(default)s)"
        self.add_argument(name, type=kind, metavar=metavar, default=default, help=shown)

    def settings(self, *names: str, without: Sequence[str] = (), **help: str) -> None:
        """Add the options of a run's settings, as `RunOptions` declares them.

        Parameters
        ----------
        *names : str
            The settings; by default all that a command can have.
        without : sequence of str
            Those that this command does not have.
        **help : str
            The help of a setting in this command, if it is not the declared one.
        """
        from softdyn.validation.loop.settings import declarations, default_of

        for name, declared in declarations().items():
            if declared.option and name in (names or (name,)) and name not in without:
                said = f"{declared.help} ({declared.unit})" if declared.unit else declared.help
                option = dict(declared.option)
                if "type" in option:
                    option["type"] = partial(_word, option["type"])
                flag = declared.flag or f"--{name}"
                option |= {"default": default_of(name), "help": help.get(name, said)}
                added = self.add_argument(flag, dest=name, **option)
                self._settings.append(added.dest)

    def given(self, arguments: Arguments, explicit: bool = False) -> dict[str, Any]:
        """The values of the settings that `settings` added: all, or only those of this call."""
        found = {name: getattr(arguments, name) for name in self._settings}
        return {
            name: value for name, value in found.items()
            if (name in self._given if explicit else value is not None)
        }  # fmt: skip

    def instead_of(self, option: str, *needed: argparse.Action, group: Any = None) -> None:
        """Declare arguments, and a group, that are needed only in calls without an option."""
        self._instead = option, needed, group

    def unused(self, options: str, when: Callable[[Arguments], bool], reason: str) -> None:
        """Declare options, separated by spaces, that the command ignores in some calls."""
        self._unused.append((options.split(), when, reason))

    def was_given(self, option: str) -> bool:
        """Whether the last call had an option, maybe with its default."""
        return self._option_string_actions[option].dest in self._given

    def warn_of_unused(self, arguments: Arguments) -> None:
        """Warn of each option that was given although this call ignores it."""
        for options, when, reason in self._unused:
            if when(arguments):
                for option in options:
                    if self.was_given(option):
                        warn_useless(option, reason)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; for a misspelt option, name the nearest one before other errors."""
        words = [str(word) for word in (sys.argv[1:] if args is None else args)]
        if self._instead is not None:
            option, needed, group = self._instead
            there = any(word.partition("=")[0] == option for word in words)
            group.required = not there
            for action in needed:  # optional ones would not stand apart on a command line
                action.nargs, action.required = ("?", False) if there else (None, True)
        known = self._option_string_actions
        for word in words:
            name = word.partition("=")[0]
            if name == "--":
                break
            value = name in ("", "-") or " " in name or self._negative_number_matcher.match(name)
            if not (value or name[0] != "-" or any(one.startswith(name) for one in known)):
                from softdyn.checks import did_you_mean
                from softdyn.exceptions import one_line

                near = did_you_mean(one_line(name), known)
                self.error(f"option: expected one of those that --help lists, got {near}")
        arguments, more = self.parse_known_args(args, namespace)
        if more:
            self.error(f"unrecognized arguments: {' '.join(more)}{self._hint(args, more[0])}")
        defaults = [(action, action.default) for action in self._actions]
        for action in self._actions:
            action.default = argparse.SUPPRESS
        self._given = {*vars(super().parse_args(args))}
        for action, default in defaults:
            action.default = default
        return arguments

    def _hint(self, args: Sequence[str] | None, word: str) -> str:
        """The option before a word that is too much, and a similar option that may be meant."""
        before = itertools.takewhile(word.__ne__, sys.argv[1:] if args is None else args)
        options = [name for name in before if name in self._option_string_actions]
        if not options:
            return ""
        own = self._option_string_actions[options[-1]].option_strings
        near = difflib.get_close_matches(
            options[-1], [name for name in self._option_string_actions if name not in own], 1, 0.8
        )
        meant = f"; did you mean {near[0]}?" if near else ""
        return f" (after {options[-1]}{meant})"

    def error(self, message: str) -> NoReturn:
        """Exit with code 2 and one line, even if the arguments are long or have line breaks."""
        from softdyn.exceptions import one_line

        self.exit(BAD_INPUT, f"error: {one_line(message, 1000)}\n")


def _word(read: Callable[[str], Any], text: str) -> Any:
    """The value of a word, by the reader of a setting."""
    from softdyn import InputError

    try:
        return read(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(f"expected {error.expected}, got {text!r}") from None
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number, got {text!r}") from None


def finite(text: str) -> float:
    """A finite number, for `type=`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a finite number, got {text!r}")
    return value


def positive(text: str) -> float:
    """A finite number > 0, for `type=`."""
    value = finite(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"expected a number > 0, got {text!r}")
    return value


def count(text: str) -> int:
    """A whole number > 0, for `type=`."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"expected a whole number > 0, got {text!r}")
    return int(text)


def whole(text: str) -> int:
    """A whole number >= 0, for `type=`."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number >= 0, got {text!r}")
    return int(text)


def add_json(parser: Parser) -> None:
    """Add the option for `write_report`, the same in every command."""
    parser.output("--json", "FILE", "write the figures as JSON; - prints them and nothing else")


def add_robot_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `load_robot`, the same in every command that takes a ROBOT."""
    parser.add_argument("--annotations", metavar="FILE", help=BLOCK)
    parser.add_argument("--floating", action="store_true", help="let the root link move freely")
    add_repair_option(parser)
    add_root_option(parser)


def add_force_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of forces of a user's own, which `load_robot` gives to the robot."""
    parser.add_argument(
        "--force", action="append", metavar="FILE.py:CLASS", default=[],
        help="a force of your own that acts on the robot, built as CLASS(); may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--force-set",
        action="append",
        metavar="NAME.FIELD=X",
        default=[],
        help="a number of a force, by its name; may be repeated",
    )


def make_forces(arguments: Arguments) -> list[Any]:
    """The forces of a command line.

    Raises
    ------
    InputError
        A class that cannot be made, and a number of a force or a field that is not there.
    """
    from softdyn.controllers.registry import find_controller
    from softdyn.validation.loop.settings import make_forces

    names = getattr(arguments, "force", ())
    return make_forces(names, force_numbers(arguments), find_controller)


def force_numbers(arguments: Arguments) -> dict[str, float]:
    """The numbers of forces that a command line sets, by NAME.FIELD.

    Raises
    ------
    InputError
        A word of another form.
    """
    from softdyn.exceptions import InputError

    found = {}
    for word in getattr(arguments, "force_set", ()):
        place, equal, text = word.partition("=")
        if not equal:
            raise InputError("--force-set", "NAME.FIELD=X", repr(word))
        try:
            found[place] = float(text)
        except ValueError:
            raise InputError(place, "a number", repr(text)) from None
    return found


def add_repair_option(parser: argparse.ArgumentParser) -> None:
    """Add --repair-inertia, for a URDF's links."""
    parser.add_argument(
        "--repair-inertia",
        action="store_true",
        help="replace impossible inertias by the nearest possible ones",
    )


def add_root_option(parser: argparse.ArgumentParser) -> None:
    """Add --root, for files that lie above the robot's own folder."""
    parser.add_argument(
        "--root", metavar="DIR",
        help="folder below which meshes (MJCF: and includes) may lie; by default the robot's own",
    )  # fmt: skip


def root_folder(arguments: Arguments) -> Path | None:
    """The folder of --root."""
    from softdyn.files import existing_folder

    return None if arguments.root is None else existing_folder("--root", arguments.root)


def warn_useless(option: str, reason: str) -> None:
    """Warn that an option changes nothing."""
    warnings.warn(f"{option} changes nothing: {reason}", stacklevel=2)


def add_server_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that serves a page."""
    parser.add_argument(
        "--port",
        type=count,
        metavar="P",
        help="port of the page (default: a free one from 7000 on)",
    )
    parser.add_argument(
        "--no-open", action="store_true", help="print the page's address and open no browser"
    )
    parser.add_argument(
        "--origin", metavar="URL",
        help="origin of a proxy on this machine that passes the page on, such as https://host",
    )  # fmt: skip


def load_robot(arguments: Arguments) -> SoftModel:
    """Load the ROBOT of the command line; warn of options that it has no use for."""
    import softdyn

    doing(f"reads {arguments.robot}")
    model = softdyn.load(
        arguments.robot,
        annotations=arguments.annotations,
        floating=arguments.floating,
        repair_inertia=arguments.repair_inertia,
        forces=make_forces(arguments),
        root=root_folder(arguments),
    )
    warn_of_no_use(model.robot, arguments)
    doing("computes")
    return model


def warn_of_no_use(robot: Robot, arguments: Arguments) -> None:
    """Warn of each option that concerns what the robot does not have."""
    options, missing = vars(arguments), lacks(robot)
    if options.get("rig") not in (None, "file"):
        missing.pop("rig", None)
    for name, reason in missing.items():
        if options.get(name):
            warn_useless(f"{robot.path}: --{name.replace('_', '-')}", reason)


def lacks(robot: Robot) -> dict[str, str]:
    """Options that this robot has no use for, and the reasons."""
    from softdyn.dynamics.text import rig_lines

    rubbing = any(tendon.rubs for tendon in robot.tendons)
    solid = [link for link in robot.links if any("<collision" in look for look in link.looks)]
    found = (
        (robot.mended, "repair_inertia", "no link has an impossible inertia"),
        (len(solid) > 1, "contacts", "fewer than two links have collision shapes"),
        (
            rubbing or any(joint.friction for joint in robot.joints),
            "friction",
            "no joint or cable has friction",
        ),
        (
            rubbing or any(rig_lines(robot)),
            "rig",
            "the file states no lag, delay, winch, sensor or friction of cables",
        ),
    )
    return {name: reason for there, name, reason in found if not there}


def best_note(model: SoftModel, name: str, gains: str | None) -> str:
    """A line saying which controller `best` is, for a robot without a schedule; else empty."""
    from softdyn.controllers.schedule import tuned

    if name != "best" or gains is not None or model.nu == 0 or tuned(model) is not None:
        return ""
    return f"best is mpc with equilibria as its targets, because {model.name} has no tuned gains"


def program(
    parser: Parser,
    command: Command,
    module: str,
    can_be_killed: Callable[[Arguments], bool] = lambda _: False,
) -> Callable[..., int]:
    """The ``main(argv=None)`` of a command: it reads the arguments and returns the exit code.

    The last line of every command is ``main = cli.program(parser, command, __name__)``. If the
    module is run as a program, the command runs at once, and Python ends with the exit code. A
    command that can be killed works in a child process, so that it has an exit code then, too.
    """

    def main(argv: list[str] | None = None) -> int:
        with ends_at_once():
            prepare_streams()
            one_thread()
            arguments = parser.parse_args(argv)
            if can_be_killed(arguments):
                from softdyn.validation.bench.supervisor import supervised

                return supervised(partial(run, command, arguments, parser), FAILED, INTERRUPTED)
        return run(command, arguments, parser)

    if module == "__main__":
        sys.exit(main())
    return main


def prepare_streams() -> None:
    """Make the streams accept any text in any encoding, and replace closed streams.

    A closed stream becomes the null device. Otherwise the next opened file would get its number,
    and the prints of the engines. stderr is written in whole lines, because worker processes share
    it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number
        if getattr(sys, name) is None and name == "stderr":
            sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    if hasattr(sys.stderr, "reconfigure"):
        sys.stderr.reconfigure(line_buffering=True, write_through=False)


def one_thread() -> None:
    """Limit BLAS and OpenMP to one thread; call it before NumPy is imported."""
    for library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
        os.environ[f"{library}_NUM_THREADS"] = "1"


def run(command: Command, arguments: Arguments, parser: Parser) -> int:
    """Call `command`, and turn its exceptions into an exit code and one line on stderr.

    For an error in a user's own code, the text on stderr is the traceback from the user's file on.
    """
    warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"
    try:
        with working(parser.prog):
            return _errors_told(command, arguments, parser)
    except BrokenPipeError:  # the reader closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PASSED
    except KeyboardInterrupt:
        with suppress(ValueError):  # not in the main thread
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one would say more
        print("error: interrupted", file=sys.stderr)
        return INTERRUPTED


def _errors_told(command: Command, arguments: Arguments, parser: Parser) -> int:
    """Call `command`, and turn softdyn's own exceptions into an exit code and one line."""
    from softdyn import InputError, SoftdynError, UrdfError
    from softdyn.exceptions import OwnCodeError, own_code_errors
    from softdyn.installed import check_engines

    try:
        with own_code_errors(program=command.__module__.partition(".")[0]):
            check_engines()
            check_outputs(parser, arguments)
            parser.warn_of_unused(arguments)
            return command(arguments)
    except OwnCodeError as error:
        print(error.trace, end="", file=sys.stderr)
        return FAILED
    except SoftdynError as error:
        print(f"error: {error}", file=sys.stderr)
        return BAD_INPUT if isinstance(error, InputError | UrdfError) else FAILED


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Let Ctrl-C end the process at once in this block, in which it only loads.

    An exception could be lost in a callback of the interpreter, or print a traceback.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def end(*_: object) -> None:
        with suppress(OSError):
            os.write(2, b"error: interrupted\n")
        os._exit(INTERRUPTED)

    signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


class _Ended(KeyboardInterrupt):
    """SIGINT or SIGTERM, which no code handles as an error."""


@contextmanager
def ends_cleanly() -> Iterator[Callable[[], bool]]:
    """Leave the block without an error when the command is ended by Ctrl-C or SIGTERM.

    It yields a function that says whether this has happened. A loop must call it, because an
    exception inside a compiler's callback or a destructor is lost.
    """
    ended = threading.Event()

    def end(*_: object) -> None:
        ended.set()
        # a second Ctrl-C must not interrupt the clean end after the first
        for number in before:
            signal.signal(number, signal.SIG_IGN)
        raise _Ended

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield ended.is_set
    except BaseException:  # what an import makes of the exception, for example
        if not ended.is_set():
            raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def offer(channel: Channel, arguments: Arguments, stream: TextIO | None = None) -> None:
    """Print the address of a served page, and open it in the browser unless asked not to."""
    print(f"{channel.url}\nCtrl-C ends it", file=stream, flush=True)
    if not arguments.no_open:
        channel.open()


def serve(
    page: Page, arguments: Arguments, over: Callable[[], bool], stream: TextIO | None = None
) -> None:
    """Serve a page until the command is ended.

    Raises
    ------
    SoftdynError
        If the server has ended before.
    """
    from softdyn.view.live.channel import Channel

    with Channel(page.html(), port=arguments.port, origin=arguments.origin) as channel:
        offer(channel, arguments, stream)
        while not over():
            channel.check()
            time.sleep(0.2)


def write_report(report: dict[str, Any], target: str | None, summary: str) -> None:
    """Print `summary`, or with target ``-`` the report as JSON; another target is a file for it."""
    from softdyn.validation.files import to_json, write_json

    if target == "-":
        say(to_json(report))
        return
    if target is not None:
        write_json(target, report)
    say(summary)


@dataclass
class Results:
    """The files of a run, which may not be lost: one that has no room is written elsewhere.

    Attributes
    ----------
    written : list of str
        The paths of the files.
    lost : bool
        Whether one is not where it was asked for.
    """

    written: list[str] = field(default_factory=list)
    lost: bool = False

    def save(self, write: Callable[[str], Any], path: str) -> None:
        """Write a file; a line on stderr says where it is if it is not at `path`."""
        from softdyn import InputError
        from softdyn.validation.files import save_somewhere

        try:
            place, error = save_somewhere(write, path)
        except InputError as fault:
            print(f"error: {fault}; nothing could be written elsewhere", file=sys.stderr)
            self.lost = True
            return
        self.written.append(place)
        if error is not None:
            print(f"error: {error}; wrote {place} instead", file=sys.stderr)
            self.lost = True

    def tell(self, report: dict[str, Any], target: str | None, text: str) -> None:
        """Write the report as `write_report` does, and print all files."""
        from softdyn import InputError
        from softdyn.validation.files import write_json

        if target not in (None, "-"):
            self.save(lambda path: write_json(path, report), target)
            target = None
        text = "\n".join(filter(None, [text, *(f"wrote {path}" for path in self.written)]))
        try:
            if text or target is not None:
                write_report(report, target, text)
        except InputError as error:  # no bad input, as the run is over
            print(f"error: {error}", file=sys.stderr)
            self.lost = True


def is_own(out: Path, mark: str) -> bool:
    """Whether there is no file `out`, or one with a text by which the command marks its files."""
    return not out.is_file() or mark.encode() in out.read_bytes()


def write_design(made: Design, out: Path, mark: str) -> None:
    """Write a robot's file, and its meshes beside it.

    A mesh replaces another one only if `out` has the command's own `mark`.

    Raises
    ------
    InputError
        If a mesh would replace another program's, or a file cannot be written.
    """
    from softdyn import InputError
    from softdyn.validation.files import atomic

    own = out.is_file() and is_own(out, mark)
    for name, content in made.meshes.items():
        there = out.parent / name
        if there.is_file() and there.read_bytes() != content and not own:
            raise InputError(str(there), "no file, or the mesh that this command writes", "another")
    for name, content in {**made.meshes, out.name: made.text.encode()}.items():
        make_folder((out.parent / name).parent)
        with atomic(out.parent / name) as file:
            file.write(content)


def report_design(made: Design, out: Path, target: str | None) -> None:
    """Report the key figures of a written robot."""
    report = {"file": str(out), "name": made.name, **made.figures}
    figures = ", ".join(f"{name} {value:.4g}" for name, value in made.figures.items())
    write_report(report, target, f"{out}: {figures}")


def save_log(log: Log, path: str) -> None:
    """Write a log as CSV if `path` ends in .csv, else as NPZ."""
    (log.to_csv if path.endswith(".csv") else log.save)(path)


def record_beside(log: Log, target: str | None) -> dict[str, Any]:
    """The record of a run for a report in a file, or for stdout."""
    from softdyn.validation.loop.repeat import record_for, whole_record

    folder = Path() if target in (None, "-") else Path(target).parent
    return record_for(whole_record(log), folder)


def read_log(path: str, model: SoftModel | None = None) -> Log:
    """Read a log, from CSV if `path` ends in .csv, else from NPZ; `model` as in `Log.from_csv`."""
    from softdyn.validation import Log

    doing(f"reads {path}")
    return Log.from_csv(path, model) if path.endswith(".csv") else Log.load(path)


@contextmanager
def saved_in_errors(path: str | None) -> Iterator[None]:
    """Save the log that an exception of the block carries; a line on stderr says so.

    Bad input that shows at the first step leaves no file.

    Parameters
    ----------
    path : str, optional
        The file; without one nothing is saved.
    """
    from softdyn.exceptions import own_frames

    try:
        yield
    except BaseException as error:
        log = getattr(error, "log", None)
        if path is not None and log is not None and (log.steps or own_frames(error)):
            results = Results()
            results.save(partial(save_log, log), path)
            for place in results.written:
                print(f"wrote {place}: the run up to t = {log.t[-1]:.4g} s", file=sys.stderr)
        raise


def say(text: str) -> None:
    """Print `text` at once, or raise an error: a full disk must not look like a success."""
    from softdyn import InputError

    if sys.stdout is None:
        raise InputError("stdout", "a stream to write to", "a closed one")
    try:
        print(text, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        # the rest of the buffer would fail again at exit, with a traceback
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise InputError("stdout", "a stream to write to", error.strerror or error) from None


def check_outputs(parser: Parser, arguments: Arguments, *more: str | Path) -> None:
    """Refuse, before any work, outputs that cannot be written or that would replace an input.

    The outputs are those of `Parser.output` and `more`. Every other argument may name a file that
    the command reads. `arguments.opened` has the contents of the files that this check has read.
    """
    given = dict(vars(arguments))
    opened: dict[Path, bytes] = {}
    arguments.opened = opened
    written = [*(given[name] for name in parser.outputs), *more]
    if not any(written):
        return
    from softdyn.validation.files import check_outputs as check
    from softdyn.validation.inputs import files_read

    values = [value for name, value in given.items() if name not in parser.outputs]
    each = (x for value in values for x in (value if isinstance(value, list | tuple) else [value]))
    # search inputs for the files that they name only if an output would replace a file
    replaces = any(path and os.path.isfile(path) for path in written)
    check(*written, read=files_read(each, opened) if replaces else frozenset())


def make_folder(path: Path) -> None:
    """Create an output folder, or raise an error that says why it cannot be used."""
    from softdyn import InputError
    from softdyn.validation.files import check_writable

    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(str(path), "a folder to write to", error.strerror or error) from None
    check_writable(path / "probe")
