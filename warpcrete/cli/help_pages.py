"""Help pages: `--help` shows the common options of a command, and `--help-all` shows all options in groups.

A terminal shows text as it is. Help pages therefore contain no markup, and no sentence that is cut off.
"""

import inspect
import re
from collections.abc import Collection
from typing import ClassVar

import click

# Every start of the program imports this module, so it must not import Warp, which takes half a second to load.

HELP_OPTIONS = {"--help", "--help-all"}
FULL_HELP = "warpcrete.full_help"
"""Key in the metadata of a Click context, with the value True if the help page must show all options."""


METHOD_DEFAULTS = "warpcrete.method_defaults"
"""Key in the metadata of a Click context, with pairs of options and values that the option `--method` sets."""


class ParameterOption(click.Option):
    """Command-line option that sets a parameter of a scene, with the heading under which help pages list it."""

    group = ""
    common = True


def plain(text: str, parameters: Collection[str] = ()) -> str:
    """Return a help text without markup, as a terminal shows it.

    The name of one of the `parameters` becomes the option that sets it. Other words in backticks get quotation marks.
    """

    def shown(match: re.Match[str]) -> str:
        name, equals, value = match[1].partition("=")
        if name not in parameters:
            return f"'{match[1]}'"
        words = [f"--{name.replace('_', '-')}", *([value.strip("\"'")] if equals else ())]
        return " ".join(words)

    text = re.sub(r":\w+:`~?\.*(?:[\w.]*\.)?(\w+)`", r"\1", text)
    return re.sub(r"`+([^`]+)`+", shown, text)


def summary(text: str) -> str:
    """Return the beginning of a help text up to its first full stop or colon."""
    return re.split(r"(?<=[a-zA-Z`)])[.:](?:\s|$)", inspect.cleandoc(text), maxsplit=1)[0].strip()


class PlainCommand(click.Command):
    """Command whose help page contains no markup."""

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        text = inspect.cleandoc(self.help or "")
        with formatter.indentation():
            formatter.write("\n")
            formatter.write_text(plain(text, {parameter.name or "" for parameter in self.params}))


class Commands(PlainCommand, click.Group):
    """Group of subcommands; its help page describes each subcommand in a whole sentence."""

    command_class: type[click.Command] | None = PlainCommand

    def descriptions(self, ctx: click.Context) -> dict[str, str]:
        """Return what each subcommand does, by the subcommand's name."""
        listed = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        return {name: summary((command and command.help) or "") for name, command in listed.items()}

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        # The method of Click would cut each description off at the end of the line.
        with formatter.section("Commands"):
            formatter.write_dl([(name, plain(text)) for name, text in self.descriptions(ctx).items()])


class WordHelp(PlainCommand):
    """Command whose help page takes the usage and the options from the help text.

    Click does not know the options of such a command, because the module of the command parses them itself. The first
    sentence of the help text must end with the usage in backticks. The options must be listed in blocks of lines that
    begin with `--`, with two or more spaces between an option and its meaning.
    """

    def format_usage(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        usage = re.search(rf"`warpcrete {self.name} ([^`]*)`", self.help or "")
        assert usage is not None
        formatter.write_usage(ctx.command_path, usage[1].replace("[options]", "[OPTIONS]"))

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        blocks = inspect.cleandoc(self.help or "").split("\n\n")
        text = [f"{summary(blocks[0])}.", *(block for block in blocks[1:] if not _lists_options(block))]
        with formatter.indentation():
            formatter.write("\n")
            formatter.write_text(plain("\n\n".join(text)))

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        listed = "\n".join(filter(_lists_options, inspect.cleandoc(self.help or "").split("\n\n"))).replace("\b\n", "")
        records: list[tuple[str, str]] = []
        for option in re.split(r"\n(?=  --)", listed):
            name, *meaning = re.split(r"\s{2,}", option.strip())
            text = " ".join(part for part in meaning if not part.startswith("[default"))
            default = [f"  {part}" for part in meaning if part.startswith("[default")]
            records.append((name, text[0].upper() + text[1:] + "".join(default)))
        with formatter.section("Options"):
            formatter.write_dl([*records, ("--help", "Show this message and exit.")])


def _lists_options(block: str) -> bool:
    return block.startswith("\b\n  --")


class GroupedCommand(PlainCommand):
    """Command whose help page has one section for each group of its options.

    `--help` shows the common options, `--help-all` all of them.
    """

    common: ClassVar[tuple[str, ...]] = (
        "method", "out", "device", "live", "colour", "accuracy", "resume", "quiet",
    )  # fmt: skip
    """Names of options that `--help` shows although they set no parameter of a scene, such as the device."""
    title = "Recording and running."
    """Title of the section of a help page that lists options which set no parameter of a scene."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        sections: dict[str, list[tuple[str, str]]] = {}
        left_out = 0
        for option in self.get_params(ctx):
            record = option.get_help_record(ctx)
            if record is None:
                continue
            own = option.name in self.common or HELP_OPTIONS & set(option.opts)
            common = option.common if isinstance(option, ParameterOption) else own
            if not common and not ctx.meta.get(FULL_HELP):
                left_out += 1
                continue
            group = option.group if isinstance(option, ParameterOption) else self.title
            sections.setdefault(group, []).append(record)
        for title, records in sections.items():
            with formatter.section(title.rstrip(".")):
                formatter.write_dl(records)
        if changed := ctx.meta.get(METHOD_DEFAULTS):
            formatter.write("\nWith this --method, these defaults differ from the ones above:\n")
            formatter.write("".join(f"  {' '.join(pair)}\n" for pair in changed))
        if left_out:
            formatter.write(f"\n{left_out} further options: {ctx.command_path} --help-all\n")


def _show_full_help(context: click.Context, option: click.Parameter, asked: bool) -> None:
    if asked and not context.resilient_parsing:
        context.meta[FULL_HELP] = True
        click.echo(context.get_help())
        context.exit()


def full_help_option() -> click.Option:
    """Return the option `--help-all`."""
    return click.Option(
        ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_full_help,
        help="Show this message with all options",
    )  # fmt: skip
