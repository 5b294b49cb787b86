"""Verbs and groups of verbs: the layout of their help, and the problems of their arguments.

Help has whole lines, names of values instead of Python's types, and verbs in groups.
"""

import inspect
import re
import textwrap
from typing import Any

from typer.core import TyperCommand, TyperGroup

from skyherd.cli.usage import explaining_usage, missing_verb, unknown_verb

NAME_COLUMN = 24
"""Characters of the widest name that has its text beside it; others have it below. Chosen for 80 columns."""

MAX_UNBROKEN = 36
"""Characters of a default that is kept on one line. Chosen: two thirds of a text's column."""

TYPES = {"int": "N", "int range": "N", "float": "NUMBER", "float range": "NUMBER", "path": "PATH"}
"""Placeholder of a value by its type, for options without a name for it."""

NO_BREAK = "\N{NO-BREAK SPACE}"
"""A space at which no line ends."""

_TYPE = re.compile(r" ?<([^>]*)>")
_BRACKETED = re.compile(r"\[(?:default: )?[^\]]*\]$")
_RANGE = re.compile(r"(-?[\d.]+)<=x<=(-?[\d.]+)")
_AT_LEAST = re.compile(r"x>=(-?[\d.]+)")

Rows = list[tuple[str, str]]
"""Names, and a text for each."""


class HelpCommand(TyperCommand):
    """A verb."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments; InputError for wrong ones."""
        with explaining_usage(self, ctx, args):
            return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the arguments as the usage shows them: `SCENARIO`, or `[NAME]` if it may be left out."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write what the verb does."""
        write_text(self.help, formatter)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options."""
        write_parameters(self, ctx, formatter)


class HelpGroup(TyperGroup):
    """A group of verbs, which are listed under the titles that they have as `rich_help_panel`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments before the verb; InputError for wrong ones."""
        with explaining_usage(self, ctx, args):
            rest = super().parse_args(ctx, args)
        if not args and not self.invoke_without_command and not ctx.resilient_parsing:
            raise missing_verb(ctx, self.list_commands(ctx))
        return rest

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Return the verb that the arguments begin with; InputError if no verb has this name."""
        if not ctx.resilient_parsing and self.get_command(ctx, args[0]) is None:
            raise unknown_verb(args[0], ctx, self.list_commands(ctx))
        return super().resolve_command(ctx, args)

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write what the group is for."""
        write_text(self.help, formatter)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options and the verbs."""
        write_parameters(self, ctx, formatter)
        self.format_commands(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a line for each verb, titles in the order in which they first occur."""
        verbs: dict[str, Rows] = {}
        for name in self.list_commands(ctx):
            verb: Any = self.get_command(ctx, name)
            title = getattr(verb, "rich_help_panel", None)
            verbs.setdefault(title if isinstance(title, str) else "Commands", []).append(
                (name, summary(verb))
            )
        width = max(len(name) for rows in verbs.values() for name, _ in rows)
        for title, rows in verbs.items():
            write_rows(title, rows, formatter, width)


def summary(verb: Any) -> str:
    """Return what a verb does, in one sentence."""
    text = inspect.cleandoc(verb.short_help or verb.help or "").split("\n\n")[0]
    return " ".join(text.split()).partition(". ")[0].rstrip(".") + "."


def parameter_rows(command: Any, ctx: Any) -> tuple[Rows, Rows]:
    """Return the arguments and the options of a verb, each with its text, without names of Python's types."""
    arguments, options = [], []
    for parameter in command.get_params(ctx):
        record = parameter.get_help_record(ctx)
        if record is None:
            continue
        name, text = record
        text = _AT_LEAST.sub(r"from \1", _RANGE.sub(r"from \1 to \2", text))
        text = _BRACKETED.sub(_unbroken, text)
        if parameter.param_type_name == "argument":
            arguments.append((_TYPE.sub("", name), re.sub(r"\s*\[required\]$", "", text)))
        else:
            options.append((_TYPE.sub(_placeholder, name), text))
    return arguments, options


def write_parameters(command: Any, ctx: Any, formatter: Any) -> None:
    """Write the arguments and the options of a verb."""
    arguments, options = parameter_rows(command, ctx)
    longest = max((len(name) for name, _ in [*arguments, *options] if len(name) <= NAME_COLUMN), default=0)
    write_rows("Arguments", arguments, formatter, longest)
    write_rows("Options", options, formatter, longest)


def write_rows(title: str, rows: Rows, formatter: Any, width: int) -> None:
    """Write a titled list; a name of more than `width` characters has its text on the next line."""
    if not rows:
        return
    lines = []
    for name, text in rows:
        margin = " " * (width + 4)
        wrapped = _wrapped(text, formatter.width - len(margin)) or [""]
        if len(name) > width:
            lines.append(f"  {name}")
        else:
            lines.append(f"  {name:{width}}  {wrapped.pop(0)}".rstrip())
        lines += [margin + line for line in wrapped]
    formatter.write(f"\n{title}:\n" + "\n".join(lines) + "\n")


def write_text(text: str | None, formatter: Any) -> None:
    """Write paragraphs of a text, indented."""
    for paragraph in inspect.cleandoc(text or "").split("\n\n"):
        formatter.write("\n" + "".join(f"  {line}\n" for line in _wrapped(paragraph, formatter.width - 2)))


def _placeholder(found: re.Match[str]) -> str:
    return f" {TYPES.get(found[1], 'TEXT')}"


def _unbroken(found: re.Match[str]) -> str:
    """Return the default of an option in one piece; a default in words loses its parentheses."""
    text = re.sub(r"default: \((.*)\)", r"default: \1", found[0])
    return text.replace(" ", NO_BREAK) if len(text) <= MAX_UNBROKEN else text


def _wrapped(text: str, width: int) -> list[str]:
    """Return the lines of the wrapped help text, never broken within a word or at a hyphen."""
    plain = " ".join(re.split(r"[ \t\n]+", text.strip()))
    lines = textwrap.wrap(plain, width, break_long_words=False, break_on_hyphens=False)
    return [line.replace(NO_BREAK, " ") for line in lines]
