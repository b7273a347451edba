"""The harness: what a test sends reaches Blender, and what goes wrong in Blender reaches the test."""

import numpy as np
import pytest
from blender_window import FailedInside


def test_typing_into_a_button_that_was_found_changes_its_property(window):
    window.open_sidebar("Item")
    button = window.find_button("location[0]")
    window.click(*button, times=2)
    window.key("ctrl+a")
    window.type("3.5")
    window.key("Return")
    assert window.run("bpy.context.object.location[0]") == 3.5


def test_keys_reach_the_area_under_the_mouse(window):
    window.run("bpy.ops.mesh.primitive_cube_add()")
    before = window.run("len(bpy.data.objects)")
    window.move(*window.region().centre)
    window.key("x", "Return")
    window.wait(f"len(bpy.context.scene.objects) == {before - 1}")


def test_a_piece_of_code_that_fails_inside_raises_its_traceback(window):
    with pytest.raises(FailedInside, match="ZeroDivisionError"):
        window.run("1 / 0")


def test_a_generator_lets_blender_live_on_between_its_steps(window):
    code = "def count():\n    for k in range(5):\n        yield\n    return k\ncount()"
    assert window.run(code) == 4


def test_an_error_in_a_draw_callback_fails_the_test(window):
    window.run(
        "def broken():\n    raise ValueError('on purpose')\n"
        "handle = bpy.types.SpaceView3D.draw_handler_add(broken, (), 'WINDOW', 'POST_PIXEL')"
    )
    window.screenshot("a broken draw callback")
    window.run("bpy.types.SpaceView3D.draw_handler_remove(handle, 'WINDOW')")
    assert any("Traceback" in line for line in window.complaints())
    window.expect("Traceback")


def test_the_reason_of_a_refusal_is_readable(window):
    window.run(
        "class Refuse(bpy.types.Operator):\n"
        "    bl_idname, bl_label = 'irpso_test.refuse', 'Refuse'\n"
        "    def execute(self, context):\n"
        "        self.report({'ERROR'}, 'on purpose')\n"
        "        return {'CANCELLED'}\n"
        "class Panel(bpy.types.Panel):\n"
        "    bl_idname, bl_label = 'IRPSO_TEST_PT_panel', 'Refusing'\n"
        "    bl_space_type, bl_region_type, bl_category = 'VIEW_3D', 'UI', 'Refusing'\n"
        "    def draw(self, context):\n"
        "        self.layout.operator('irpso_test.refuse')\n"
        "bpy.utils.register_class(Refuse)\n"
        "bpy.utils.register_class(Panel)"
    )
    window.open_sidebar("Refusing")
    window.click(*window.find_button("irpso_test.refuse"))
    assert window.reports()[-1] == "on purpose"
    window.screenshot("an operator that refuses")
    window.move(*window.region().centre)
    window.run("bpy.utils.unregister_class(Panel)\nbpy.utils.unregister_class(Refuse)")


def test_pixels_are_what_the_screen_shows(window):
    window.run(
        "import gpu\nfrom gpu_extras.batch import batch_for_shader\n"
        "shader = gpu.shader.from_builtin('UNIFORM_COLOR')\n"
        "def square():\n"
        "    corners = [(100, 100), (140, 100), (140, 120), (100, 120)]\n"
        "    shader.bind()\n"
        "    shader.uniform_float('color', (1, 0, 0, 1))\n"
        "    batch_for_shader(shader, 'TRIS', {'pos': corners}, indices=[(0, 1, 2), (0, 2, 3)]).draw(shader)\n"
        "handle = bpy.types.SpaceView3D.draw_handler_add(square, (), 'WINDOW', 'POST_PIXEL')"
    )
    view = window.region()
    shown = window.pixels(view)
    window.run("bpy.types.SpaceView3D.draw_handler_remove(handle, 'WINDOW')\ndel shader, square")
    red = np.argwhere((shown == (255, 0, 0)).all(axis=2))
    # 4.3 draws a region's pixels 0.01 off, which moves an edge by one.
    assert tuple(red.min(axis=0)) == pytest.approx((view.height - 120, 100), abs=1)
    assert tuple(red.max(axis=0)) == pytest.approx((view.height - 101, 139), abs=1)
