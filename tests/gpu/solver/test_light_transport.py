"""Light that a mesh throws on itself, where the answer is known: in hollow spheres."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.blender.ray_caster import ray_caster
from irpso_addon.capture.types import Light
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.domain import domain_of
from irpso_addon.geometry.light.light_transport import light_transport_steps
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.interreflection.indirect_light import IndirectLight
from tests.builders.cavity import cavity, cavity_mesh
from tests.builders.domains import unit
from tests.builders.rounds import ALBEDO, LAMBERT
from tests.oracles.reflectance import metallic_roughness


def transport_of(mesh, domain, resolution=48, rays=64):
    return run_steps(light_transport_steps(mesh, domain.bake, domain.lights, ray_caster(mesh), resolution, rays))


def maps_of(domain, **values):
    values["normal"] = 0, 0, 1
    return {name: np.broadcast_to(np.float32(value), (*domain.shape, len(value))) for name, value in values.items()}


def indirect(mesh, domain, albedo, bounces, rays=64, model=LAMBERT, **numbers):
    maps = maps_of(domain, base_color=albedo, **{name: (value,) for name, value in numbers.items()})
    transport = transport_of(mesh, domain, rays=rays)
    with closing(IndirectLight(domain, transport, model, maps, domain.solvable, bounces)) as light:
        return light.samples(run_steps(light.of_elements())[0]).at(0, *np.nonzero(light.covered))


@pytest.mark.parametrize("bounces", [1, 2, 4])
def test_a_closed_sphere_sends_on_its_albedo_at_every_bounce(bounces):
    # A light in the middle makes every place send its albedo ρ, and all of that meets others: bounce i adds ρ^(i + 1).
    mesh, albedo = cavity_mesh(), np.array([0.8, 0.5, 0.1])
    found = indirect(mesh, cavity(mesh), albedo, bounces)
    wanted = sum(albedo ** (i + 1) for i in range(1, bounces + 1))
    np.testing.assert_allclose(found.mean(axis=0), wanted, rtol=0.01)
    np.testing.assert_allclose(found, np.broadcast_to(wanted, found.shape), rtol=0.05)


def test_shading_normals_far_from_the_faces_hide_no_light():
    # As of a smooth-shaded box. Shape and recovered normals are those of the sphere.
    mesh, albedo = cavity_mesh(), np.array([0.8, 0.5, 0.1])
    leaning = unit(mesh.normals + 0.8 * mesh.tangents[..., :3])
    along = mesh.tangents[..., :3] - (mesh.tangents[..., :3] * leaning).sum(axis=-1, keepdims=True) * leaning
    mesh = replace(mesh, normals=leaning, tangents=np.concatenate([unit(along), mesh.tangents[..., 3:]], axis=-1))
    domain = cavity(mesh)
    maps = maps_of(domain, base_color=albedo)
    maps["normal"] = np.einsum("hwij,hwj->hwi", domain.bake.frames(), -domain.bake.position).astype(np.float32)
    with closing(IndirectLight(domain, transport_of(mesh, domain), LAMBERT, maps, domain.solvable, 2)) as light:
        found = light.samples(run_steps(light.of_elements())[0]).at(0, *np.nonzero(light.covered))
    np.testing.assert_allclose(found.mean(axis=0), albedo**2 + albedo**3, rtol=0.02)


@pytest.mark.parametrize("factor", [2.0**-14, 2.0**14])
def test_the_unit_of_the_intensities_changes_no_bit(factor):
    # The limit of a ray's radiance cuts off the second bounce of strong lights where it counts in radiance itself.
    mesh, albedo = cavity_mesh(), np.array([0.8, 0.5, 0.1])
    domain = cavity(mesh)
    other = replace(domain, intensities=domain.intensities * np.float32(factor))
    found = [indirect(mesh, one, albedo, 4) for one in (domain, other)]
    np.testing.assert_array_equal(found[1], found[0] * np.float32(factor))
    with closing(IndirectLight(domain, transport_of(mesh, domain), LAMBERT, maps_of(domain, base_color=albedo),
                               domain.solvable, 1)) as light:  # fmt: skip
        np.testing.assert_array_equal(light._units, 1)  # though the light is in the middle of the elements


def test_elements_say_what_the_light_itself_makes_them_send():
    mesh, albedo = cavity_mesh(), np.array([0.8, 0.5, 0.1])
    domain = cavity(mesh)
    maps = maps_of(domain, base_color=albedo)
    with closing(IndirectLight(domain, transport_of(mesh, domain), LAMBERT, maps, domain.solvable, 2)) as light:
        np.testing.assert_allclose(run_steps(light.of_elements())[1][0], albedo.mean(), rtol=0.02)


def test_a_beam_lights_only_what_it_reaches():
    # Of the square of the cosine within 60° of the axis, a sphere receives ∫ z² dz / 2 for z in ½ … 1 on average, and
    # sends it on everywhere. The samples are divided by the beam where it reaches.
    mesh, albedo = cavity_mesh(), np.array([0.8, 0.5, 0.1])
    beam = Light((0.0, 0.0, 0.0), distant=False, axis=(0.0, 0.0, 1.0), cone=60.0, cosine=2.0).beam
    domain = replace(cavity(mesh), beams=np.append((0, 0, 0), beam)[None].astype(np.float32))
    found = indirect(mesh, domain, albedo, 1, rays=512)
    height = -domain.bake.normal[domain.bake.coverage][:, 2]
    reached = np.where(height > 0.5, height**2, 1.0)
    wanted = albedo**2 * (1 - 0.5**3) / 6
    np.testing.assert_allclose(found * reached[:, None], np.broadcast_to(wanted, found.shape), rtol=0.12)
    np.testing.assert_allclose((found * reached[:, None]).mean(axis=0), wanted, rtol=0.01)


@pytest.mark.parametrize("bounces", [1, 2, 3])
def test_half_a_sphere_keeps_half_of_it_at_every_bounce(bounces):
    mesh = cavity_mesh(opening=0.0)
    found = indirect(mesh, cavity(mesh), (0.6, 0.6, 0.6), bounces, rays=256)
    wanted = sum(0.5**i * 0.6 ** (i + 1) for i in range(1, bounces + 1))
    np.testing.assert_allclose(found.mean(), wanted, rtol=0.01)


def test_observations_of_several_cameras_are_each_as_if_alone():
    mesh, model = cavity_mesh(opening=0.0), load_model("metallic_roughness")
    domain = cavity(mesh)
    places, rng = np.array([(0.2, 0.1, -0.3), (0.0, 0.3, 0.1), (-0.4, 0.0, 0.0)]), np.random.default_rng(3)
    lights = np.hstack([rng.uniform(-0.4, 0.4, (7, 3)), np.ones((7, 1))]).astype(np.float32)
    views = np.hstack([places[[0, 1, 0, 2, 0, 0, 0]], np.ones((7, 1))]).astype(np.float32)
    colours = rng.uniform(0.5, 1, (7, 3)).astype(np.float32)
    maps = maps_of(domain, base_color=ALBEDO, roughness=(0.4,), metallic=(1.0,), specular=(0.5,))

    def radiances(chosen):
        stack = np.ones((len(chosen), *domain.shape, 4), np.float32)
        own = domain_of(domain.bake, stack, lights[chosen], colours[chosen], views[chosen], card=False)
        with closing(IndirectLight(own, transport_of(mesh, own), model, maps, own.solvable, 3)) as light:
            return run_steps(light.of_elements())

    together = radiances(range(7))
    for k in range(7):
        for all_of_them, alone in zip(together, radiances([k]), strict=True):
            np.testing.assert_allclose(all_of_them[k], alone[0], rtol=1e-3, atol=1e-6)


def sent_on_in_a_sphere(material, bounces, steps=48):
    """Return (3,): what a closed sphere sends to its middle, of a light of intensity 1 there, after some bounces.

    A ray that leaves a place of a sphere at an angle arrives at another at the same angle, so the radiance L of that
    angle becomes L′(v) = ∫ f(l, v) L(l) cos dω: by the midpoint rule over the projected hemisphere.
    """
    squared = (np.arange(steps) + 0.5) / steps
    angle = 2 * np.pi * (np.arange(4 * steps) + 0.5) / (4 * steps)
    slant, around = np.meshgrid(np.arcsin(np.sqrt(squared)), angle, indexing="ij")
    light = np.stack([np.sin(slant) * np.cos(around), np.sin(slant) * np.sin(around), np.cos(slant)], axis=-1)
    views = np.concatenate([np.array([[0.0, 0.0, 1.0]]), light[:, 0]])  # the middle, and every angle
    up = {"normal": np.array([0.0, 0.0, 1.0])}
    sent = metallic_roughness(material | up, up["normal"], views)
    total = np.zeros(3)
    for _ in range(bounces):
        arriving = sent[1:, None]
        shares = [metallic_roughness(material | up, light, view) / light[..., 2:] for view in views]
        sent = np.stack([(share * arriving).mean(axis=(0, 1)) for share in shares])
        total += sent[0]
    return total


# Two bounces are followed ray by ray; at the third an element passes on the mean over all directions: a sphere, which
# sends lobes back and forth through its middle, is the worst case.
@pytest.mark.parametrize(("bounces", "tolerance"), [(1, 0.01), (2, 0.01), (3, 0.04)])
def test_a_closed_sphere_of_metal_sends_on_what_its_lobe_reflects(bounces, tolerance):
    mesh = cavity_mesh()
    numbers = {"roughness": 0.5, "metallic": 1.0, "specular": 0.5}
    model = load_model("metallic_roughness")
    found = indirect(mesh, cavity(mesh), ALBEDO, bounces, rays=512, model=model, **numbers)
    wanted = sent_on_in_a_sphere(
        {"base_color": np.array(ALBEDO), **{n: np.array(v) for n, v in numbers.items()}}, bounces
    )
    np.testing.assert_allclose(found.mean(axis=0), wanted, rtol=tolerance)


def test_lobes_narrower_than_the_rays_stand_apart_are_widened():
    mesh, model = cavity_mesh(opening=0.0), load_model("metallic_roughness")
    smooth, wide, wider = (
        indirect(mesh, cavity(mesh), ALBEDO, 2, model=model, roughness=roughness, metallic=1.0, specular=0.5)
        for roughness in (0.05, 0.3, 0.4)
    )
    np.testing.assert_array_equal(smooth, wide)
    assert not np.allclose(wide, wider, rtol=0.05)


@pytest.mark.parametrize(("shape", "cells"), [((24, 48), (24, 48)), ((40, 80), (32, 64)), ((64, 128), (32, 64))])
def test_elements_are_as_fine_as_the_resolution_allows(shape, cells):
    mesh = cavity_mesh()
    transport = transport_of(mesh, cavity(mesh, shape), resolution=64, rays=1)
    rows, columns = np.divmod(transport.texels, shape[1])
    # Each in a cell of its own, at the texel nearest to its middle.
    for at, texels, count in ((rows, shape[0], cells[0]), (columns, shape[1], cells[1])):
        place = (np.unique(at) + 0.5) * count / texels
        assert (np.floor(place) == np.arange(count)).all()
        assert np.abs(place - np.floor(place) - 0.5).max() <= 0.5 * count / texels
    assert len(transport.texels) == cells[0] * cells[1]


def test_a_place_whose_material_is_not_known_has_that_of_the_nearest():
    mesh = cavity_mesh()
    domain = cavity(mesh)
    known = np.zeros(domain.shape, bool)
    known[:, ::2] = True
    albedo = np.where(known[..., None], np.float32([0.8, 0.5, 0.1]), 0)
    with closing(
        IndirectLight(
            domain, transport_of(mesh, domain), LAMBERT,
            {"base_color": albedo, "normal": np.broadcast_to(np.float32([0, 0, 1]), (*domain.shape, 3))}, known, 1,
        )
    ) as light:  # fmt: skip
        np.testing.assert_allclose(
            light.materials["base_color"], np.tile([[0.8, 0.5, 0.1]], (known.size, 1)), rtol=1e-6
        )


@pytest.mark.parametrize("solvable", [True, False])
def test_where_no_element_is_known_solvable_ones_send_light(solvable):
    mesh = cavity_mesh()
    domain = cavity(mesh)
    domain = replace(domain, solvable=np.full(domain.shape, solvable))
    maps = maps_of(domain, base_color=(0.8, 0.5, 0.1) if solvable else (0, 0, 0))
    none = np.zeros(domain.shape, bool)
    with closing(IndirectLight(domain, transport_of(mesh, domain), LAMBERT, maps, none, 1)) as light:
        sent = run_steps(light.of_elements())[0].mean(axis=(0, 1))
    # The least albedo of an element is 0.02.
    np.testing.assert_allclose(sent, np.square((0.8, 0.5, 0.1) if solvable else (0.02,) * 3), rtol=0.02)
