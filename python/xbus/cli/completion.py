"""``xbus completion``: scripts that complete commands in a shell."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from xbus.cli.printing import print_line

__all__ = ["completion"]

SHELLS = ("bash", "fish", "zsh")


@click.command(
    epilog="Example: xbus completion bash > ~/.local/share/bash-completion/completions/xbus"
)
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Prints a script that completes commands, options and files.

    bash reads it from ~/.local/share/bash-completion/completions/xbus, and fish from
    ~/.config/fish/completions/xbus.fish. For zsh add to ~/.zshrc, below compinit: source <(xbus completion
    zsh). It takes effect in a new shell.
    """
    root = click.get_current_context().find_root()
    kind = get_completion_class(shell)
    assert kind is not None  # noqa: S101 - click has these shells
    print_line(kind(root.command, {}, "xbus", "_XBUS_COMPLETE").source())
