"""``python -m irpso_addon …``: the command line through the bpy wheel."""

import sys

from .cli import main

sys.exit(main(sys.argv[1:]))
