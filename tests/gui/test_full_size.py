"""Recoveries as large as people's own, one after the other in one window: small ones come to no limit of a driver."""

from tests.gui.test_run import MODULES

FEW = {"prefit_iterations": 0, "iterations": 1, "refinement_iterations": 1, "refinement_starts": False,
       "refinement_rounds": 0, "prior_rounds": 0}  # fmt: skip
# Of what lavapipe may map in one process, 65 530 (irpso_addon/gpu/context.py); Blender's own drawing takes its part.
MAPPINGS = 60_000
COUNT = "sum('memfd:allocation' in line for line in open('/proc/self/maps'))"


def test_blender_outlives_two_full_size_recoveries_the_second_of_another_model(window, shared_data):
    window.run(MODULES, area="")
    window.run(f"bpy.ops.irpso.import_capture(filepath={str(shared_data / 'rti_icon')!r})", timeout=120)
    window.run("settings = bpy.context.scene.irpso\nsettings.subject = 'CARD'\nsettings.light_strengths = 'GIVEN'")
    window.run("\n".join(f"settings.schedule.{name} = {value}" for name, value in FEW.items()))
    for model in ("principled", "principled_metallic"):
        window.run(f"settings.model = {model!r}\nbpy.ops.irpso.recover('INVOKE_DEFAULT')", timeout=120)
        window.wait("session.current().state == 'done'", 900)
        assert window.run("session.current().failure") == ""
        assert window.run("session.current().domain.shape") == [395, 402]
        window.screenshot(f"full-size-{model}")
        window.run("bpy.ops.irpso.cancel()")
        window.run("redrawn()", area="")
    mapped = window.run(COUNT)
    assert mapped < MAPPINGS, mapped
