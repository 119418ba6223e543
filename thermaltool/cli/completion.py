"""``thermaltool completion``: what completes commands and options in a shell."""

from __future__ import annotations

import click

SHELLS = ("bash", "zsh", "fish")


@click.command(epilog="Example: thermaltool completion bash > ~/.local/share/bash-completion/"
               "completions/thermaltool")  # fmt: skip
@click.argument("shell", type=click.Choice(SHELLS))
def command(shell: str) -> None:
    """Script that completes commands and options in bash, zsh or fish.

    \b
    For one session:
      bash, zsh   source <(thermaltool completion bash)
      fish        thermaltool completion fish | source
    For all:
      bash        thermaltool completion bash \\
                    > ~/.local/share/bash-completion/completions/thermaltool
      zsh         thermaltool completion zsh > ~/.zfunc/_thermaltool
                  (~/.zfunc in fpath, before compinit)
      fish        thermaltool completion fish \\
                    > ~/.config/fish/completions/thermaltool.fish
    """
    from click.shell_completion import get_completion_class

    from thermaltool.cli import group

    script = get_completion_class(shell)
    assert script is not None
    click.echo(script(group, {}, "thermaltool", "_THERMALTOOL_COMPLETE").source())
