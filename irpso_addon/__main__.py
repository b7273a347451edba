"""``python -m irpso_addon …``: the command line through the bpy wheel."""

import sys

from .cli import main

if __name__ == "__main__":
    code = main()
    if "bpy" in sys.modules:  # a process with Blender in it does not always survive its own exit
        from .gpu.context import exit_process

        exit_process(code)
    sys.exit(code)
