"""Ends Blender 5.2.2 by SIGSEGV on Mesa 26.2.6's software Vulkan, without any add-on: redraws, and counts mappings.

Usage, on an X server: blender --factory-startup --gpu-backend vulkan --python tests/gui/software_vulkan.py
Prints how many mappings lavapipe holds after every 20 redraws of the window: 264 more for each, and none is given back.
The end comes where Linux gives a process no more (vm.max_map_count, 65 530). On OpenGL there are none.
irpso_addon/gpu/context.py, is_software_vulkan, says why.
"""

import bpy

REDRAWS = 400
redraws = 0


def mappings():
    """Return how many parts of lavapipe's memory are mapped."""
    with open("/proc/self/maps", encoding="utf-8") as lines:
        return sum("memfd:allocation" in line for line in lines)


def redraw():
    """Have the whole window drawn again, every 50 ms."""
    global redraws
    if redraws % 20 == 0:
        print(f"{redraws} redraws: {mappings()} mappings", flush=True)
    redraws += 1
    if redraws > REDRAWS:
        bpy.ops.wm.quit_blender()
        return None
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            area.tag_redraw()
    return 0.05


bpy.app.timers.register(redraw)
