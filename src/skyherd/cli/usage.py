"""Wrong arguments of a verb as problems of one line: which option, what is wrong, and what is allowed.

The parser that reads the arguments has messages of its own, which differ between its versions. They are
replaced here, at the one place where each verb is parsed. A text on an allowed value is the help text of its
option or argument, so that required ones should give an example there.
"""

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import typer
from typer.models import ParameterInfo

from skyherd.errors import InputError
from skyherd.text import did_you_mean, one_of, shorten

UsageError: type[Exception] = typer.BadParameter.__base__ or typer.BadParameter
"""Root of what Typer raises for wrong arguments: click's, or that of its own copy of click."""

UNITS = {"M": ("metres", "0.12"), "S": ("seconds", "2"), "SECONDS": ("seconds", "60")}
"""Unit of a number by the placeholder of its option, and an example in it."""

MAX_VALUE = 60
"""Characters of a wrong value that are shown. *Chosen*: most of a line."""


class Number(NamedTuple):
    """A number that an option or argument takes.

    Attributes:
        kind: int or float.
        least, most: the range; None without a limit.
        unit: the plural of its unit; empty without one.
        example: a valid number.
    """

    kind: type
    least: float | None
    most: float | None
    unit: str
    example: str

    def allowed(self) -> str:
        """Return the words for the allowed numbers."""
        words = "a whole number" if self.kind is int else f"a number{' of ' * bool(self.unit)}{self.unit}"
        limits = [f" from {self.least:g}"] if self.least is not None else []
        limits += [f"{' to' if limits else ' up to'} {self.most:g}"] if self.most is not None else []
        return f"{words}{''.join(limits)}, such as {self.example}"

    def problem(self, text: str) -> str | None:
        """Return what is wrong with a text as this number; None if nothing is."""
        name = "whole number" if self.kind is int else "number"
        try:
            value = self.kind(text)
        except ValueError:
            return f"{shorten(text, MAX_VALUE)!r} is not a {name}"
        if self.least is not None and value < self.least:
            return f"{text} is too small"
        if self.most is not None and value > self.most:
            return f"{text} is too large"
        return f"{text} is not a {name}" if value != value else None


@contextmanager
def explaining_usage(command: Any, context: Any, arguments: Sequence[str]) -> Iterator[None]:
    """Convert an error of the parser in the body into an InputError.

    Args:
        command: the verb, or the group of verbs.
        context: its context.
        arguments: all arguments of the verb, before they are parsed.
    """
    given = list(arguments)
    try:
        yield
    except UsageError as error:
        raise _explained(error, command, context, given) from None


def only_known(names: Sequence[str]) -> Callable[[typer.CallbackParam, str | None], str | None]:
    """Return a callback that refuses values of an option other than these."""

    def check(parameter: typer.CallbackParam, value: str | None) -> str | None:
        if value is not None and value not in names:
            raise InputError(option_name(parameter), f"{shorten(value, MAX_VALUE)!r}", one_of(value, names))
        return value

    return check


def unknown_verb(name: str, context: Any, known: Sequence[str]) -> InputError:
    """Return the problem of a word that is no verb."""
    return InputError(context.command_path, f"no verb {shorten(name, MAX_VALUE)!r}", one_of(name, known))


def missing_verb(context: Any, known: Sequence[str]) -> InputError:
    """Return the problem of a group of verbs without a verb."""
    return InputError(context.command_path, "its verb is missing", one_of("", known))


def option_name(parameter: Any) -> str:
    """Return the name of an option or argument, as a user types or reads it."""
    if parameter.param_type_name == "option":
        return str(max(parameter.opts, key=lambda name: name.startswith("--")))
    return str(parameter.metavar or parameter.name.upper())


def _explained(error: Any, command: Any, context: Any, arguments: list[str]) -> InputError:
    parameters = command.get_params(context)
    parameter = getattr(error, "param", None)
    if parameter is not None:
        name, info = option_name(parameter), _declaration(command, parameter)
        if type(error).__name__ == "MissingParameter":
            return InputError(name, "missing", f"{_described(parameter)}; {_help(context)}")
        values = _values(command, context, parameter, arguments)
        number = _number(parameter, info)
        problems = [found for value in values if number and (found := number.problem(value))]
        if number and problems:
            return InputError(name, problems[0], number.allowed())
        return InputError(name, _first_line(error.message), _described(parameter))
    if (typed := getattr(error, "option_name", None)) is not None:
        return _wrong_option(typed, command, context, parameters)
    if extra := _unread(command, context, arguments):
        takes = [option_name(one) for one in parameters if one.param_type_name == "argument"]
        allowed = f"it takes {' and '.join(takes) or 'options only'}; put a name with spaces into quotes"
        what = f"{shorten(extra[0], MAX_VALUE)!r} is one argument too many"
        return InputError(context.command_path, what, allowed)
    return InputError(context.command_path, _first_line(error.format_message()), _help(context))


def _wrong_option(typed: str, command: Any, context: Any, parameters: Sequence[Any]) -> InputError:
    """Return the problem of an option that is unknown, lacks its value, or has one that it does not take."""
    options = {name: one for one in parameters for name in (*one.opts, *one.secondary_opts)}
    options = {name: one for name, one in options.items() if name.startswith("-")}
    if (option := options.get(typed)) is None:
        known = ", ".join(dict.fromkeys(map(option_name, options.values())))
        allowed = did_you_mean(typed, options) or f"one of {known};"
        return InputError(typed, f"no option of `{context.command_path}`", f"{allowed} {_help(context)}")
    if getattr(option, "is_flag", False):
        return InputError(typed, "takes no value", f"{typed} alone")
    number = _number(option, _declaration(command, option))
    allowed = number.allowed() if number else f"write `{typed} {option.metavar}`; {_help(context)}"
    return InputError(typed, "its value is missing", allowed)


def _described(parameter: Any) -> str:
    """Return the help text of an option or argument as the words for what it takes."""
    text = " ".join(inspect.cleandoc(parameter.help or "a value").split()).rstrip(".")
    return text[0].lower() + text[1:] if text[1:2].islower() or text[1:2] == " " else text


def _help(context: Any) -> str:
    return f"see `{context.command_path} --help`"


def _first_line(message: str) -> str:
    return message.strip().split("\n")[0].rstrip(".")


def _unread(command: Any, context: Any, arguments: list[str]) -> list[str]:
    """Return the arguments that no option and no argument of a verb takes."""
    return [str(word) for word in command.make_parser(context).parse_args(args=list(arguments))[1]]


def _values(command: Any, context: Any, parameter: Any, arguments: list[str]) -> list[str]:
    """Return the texts that were given for an option or argument."""
    given = command.make_parser(context).parse_args(args=list(arguments))[0].get(parameter.name)
    return [str(value) for value in (given if isinstance(given, list | tuple) else [given])]


def _declaration(command: Any, parameter: Any) -> tuple[type | None, ParameterInfo | None]:
    """Return the type of an option or argument, or of its items, and its declaration; None if unknown."""
    declared = inspect.signature(command.callback).parameters.get(parameter.name)
    if declared is None:
        return None, None
    found, info = declared.annotation, declared.default
    if get_origin(found) is Annotated:
        found, info = get_args(found)[:2]
    while inner := [one for one in get_args(found) if one is not type(None)]:
        found = inner[0]
    return found, info if isinstance(info, ParameterInfo) else None


def _number(parameter: Any, declared: tuple[type | None, ParameterInfo | None]) -> Number | None:
    """Return the number that an option or argument takes; None if it takes another value."""
    kind, info = declared
    if kind not in (int, float) or info is None:
        return None
    unit, example = UNITS.get(parameter.metavar, ("", "2"))
    if isinstance(parameter.default, int | float):
        example = f"{parameter.default:g}"
    return Number(kind, info.min, info.max, unit, example)
