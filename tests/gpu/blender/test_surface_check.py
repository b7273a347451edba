"""Whether an object still has the material slots and the UV map of its recovery."""

import bpy
import pytest

from irpso_addon.blender.materials.surface_check import check_surface, uv_warnings
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.core.errors import InputError


@pytest.fixture
def grid():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4)
    yield bpy.context.object
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")


def test_nothing_is_known_of_a_mesh_whose_modifier_drops_the_uv_map(grid):
    mesh = extract_mesh(grid)
    grid.modifiers.new("Remesh", "REMESH").mode = "BLOCKS"
    check_surface(grid, mesh, "Grid")
    before = len(bpy.data.meshes)
    assert uv_warnings(grid, mesh) == [] and len(bpy.data.meshes) == before


def test_a_uv_map_edited_on_a_linked_duplicate_is_warned_of_before_edit_mode_ends(grid):
    import bmesh  # exists once bpy is imported

    mesh = extract_mesh(grid)
    twin = grid.copy()
    bpy.context.scene.collection.objects.link(twin)
    grid.select_set(False)
    twin.select_set(True)
    bpy.context.view_layer.objects.active = twin
    bpy.ops.object.mode_set(mode="EDIT")
    edited = bmesh.from_edit_mesh(twin.data)
    layer = edited.loops.layers.uv.active
    for loop in (loop for face in edited.faces for loop in face.loops):
        loop[layer].uv *= 0.5
    bmesh.update_edit_mesh(twin.data)
    (warning,) = uv_warnings(grid, mesh)
    assert "of 'Grid' has changed since its maps were recovered" in warning


@pytest.mark.parametrize("name", [None, "skin"])
def test_slots_that_look_alike_have_moved_where_their_faces_have_another_slot(grid, name):
    material = bpy.data.materials.new(name) if name else None
    for _ in range(2):
        grid.data.materials.append(material)
    for number, face in enumerate(grid.data.polygons):
        face.material_index = number % 2
    mesh = extract_mesh(grid, (1,))
    check_surface(grid, mesh, "Grid")
    grid.data.polygons[1].material_index = 0  # one face to another slot, as one pleases
    check_surface(grid, mesh, "Grid")
    grid.data.polygons[1].material_index = 1
    with bpy.context.temp_override(object=grid, active_object=grid):
        bpy.ops.object.material_slot_move(direction="DOWN")
    with pytest.raises(InputError, match=f"all faces of material slot 1 '{name or 'slot 1'}' of 'Grid' have another"):
        check_surface(grid, mesh, "Grid")
    assert len(bpy.data.meshes) == 1


def test_slots_of_one_material_may_be_merged_where_both_were_recovered(grid):
    for _ in range(2):
        grid.data.materials.append(bpy.data.materials.get("skin") or bpy.data.materials.new("skin"))
    for number, face in enumerate(grid.data.polygons):
        face.material_index = number % 2
    both, first = extract_mesh(grid), extract_mesh(grid, (0,))
    for face in grid.data.polygons:
        face.material_index = 0
    check_surface(grid, both, "Grid")
    with pytest.raises(InputError, match="all faces of material slot 1 'skin' of 'Grid' have another slot since"):
        check_surface(grid, first, "Grid")  # the maps have no texels for them


@pytest.mark.parametrize("moved", [1, 2])
def test_a_recovered_slot_whose_faces_go_to_one_that_was_not_has_moved(grid, moved):
    for _ in range(3):
        grid.data.materials.append(None)
    for number, face in enumerate(grid.data.polygons):
        face.material_index = number % 3
    mesh = extract_mesh(grid, (0, 1))
    for face in grid.data.polygons:
        face.material_index = {1: (0, 2, 2), 2: (0, 1, 0)}[moved][face.material_index]
    with pytest.raises(InputError, match=f"all faces of material slot {moved} 'slot {moved}' of 'Grid'"):
        check_surface(grid, mesh, "Grid")


def test_a_mesh_without_slots_has_none_that_could_move(grid):
    for face in grid.data.polygons:
        face.material_index = 1  # as a former second slot leaves it
    mesh = extract_mesh(grid)
    for _ in range(2):
        grid.data.materials.append(None)
    check_surface(grid, mesh, "Grid")
