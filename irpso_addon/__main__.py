"""``python -m irpso_addon …``: the command line through the bpy wheel."""

import sys

from .cli import main

if __name__ == "__main__":
    code = main()
    if "bpy" in sys.modules:  # with bpy loaded, Python's own exit may hang or crash
        from .gpu.context import exit_process

        exit_process(code)
    sys.exit(code)
