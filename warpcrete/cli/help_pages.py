"""Help pages: `--help` shows the common options of a command, and `--help-all` shows all options in groups."""

from typing import ClassVar

import click

# Every start of the program imports this module, so it must not import Warp, which takes half a second to load.

HELP_OPTIONS = {"--help", "--help-all"}
FULL_HELP = "warpcrete.full_help"
"""Key in the metadata of a Click context, with the value True if the help page must show all options."""


class ParameterOption(click.Option):
    """Command-line option that sets a parameter of a scene, with the heading under which help pages list it."""

    group = ""
    common = True


class GroupedCommand(click.Command):
    """Command whose help page has one section for each group of its options.

    `--help` shows the common options, `--help-all` all of them.
    """

    common: ClassVar[tuple[str, ...]] = (
        "out", "device", "live", "colour", "accuracy", "resume", "quiet",
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
