"""``s2r completion``: the script that makes a shell complete ``s2r``."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_HOW = {
    "bash": "s2r completion bash > ~/.local/share/bash-completion/completions/s2r",
    "zsh": "s2r completion zsh > ~/.zfunc/_s2r   # with fpath+=~/.zfunc before compinit",
    "fish": "s2r completion fish > ~/.config/fish/completions/s2r.fish",
}


@click.command()
@click.argument("shell", type=click.Choice(sorted(_HOW)))
def completion(shell: str) -> None:
    """Print the completion script of SHELL; its first line says where it goes."""
    from s2r_protocol.cli.root import s2r

    kind = get_completion_class(shell)
    assert kind is not None, f"click knows no completion for {shell}"
    click.echo(f"# {_HOW[shell]}")
    click.echo(kind(s2r, {}, "s2r", "_S2R_COMPLETE").source())
