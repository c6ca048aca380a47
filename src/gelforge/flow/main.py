"""How every module's `main` ends."""

import os
import sys

from gelforge.errors import GelforgeError


def exit_with(main, argv=None) -> None:
    """Run `main(argv)` and leave the process with its code; 2 and one line for what a user can mend."""
    try:
        code = main(argv)
    except GelforgeError as error:
        print(f"error: {error}", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        code = 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 141
    sys.exit(code)
