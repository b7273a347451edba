"""What the user sets, kept in the .blend: the scene's settings, the view's, and each light's image."""

import math
from collections.abc import Callable

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ...core.errors import InputError
from ...core.paths import DEFAULT_MODEL
from ...reflectance.model import ReflectanceModel, load_model, shipped_models
from ...solver.lights.refine import MOST_DEGREES
from ...solver.views.texel_probe import component_names
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute
from .schedule_settings import ScheduleSettings

CUSTOM = "CUSTOM"  # a model of the user's own
REACTIONS: dict[str, Callable[[bpy.types.PropertyGroup], None]] = {}  # setting → what an operator's module does of it
_LARGEST_SIDE = 16384
_COLOUR_SPACES = (
    ("auto", "Automatic", "8-bit images are sRGB unless they state or show to be linear, all others linear"),
    ("srgb", "sRGB", "All images are sRGB, as cameras write JPEG"),
    ("linear", "Linear", "All images hold linear radiance"),
)
_SOURCES = (
    ("FILES", "Files", "A folder of photographs with their lights, an .lp list or a capture.toml"),
    ("SCENE", "This Scene", "The cameras and lights of the open file, each light with its image"),
)
_STRENGTHS = (
    (
        "AUTO",
        "Automatic",
        "As given, or estimated where the capture tells none and the photographs contradict equal ones",
    ),
    ("GIVEN", "As Given", "Light intensities as the capture or the scene has them; 1 where it tells none"),
    ("ESTIMATE", "Estimate", "Find how strong each light was from the photographs, up to one scale, before the search"),
)
_HOLD_OUT = (
    ("OFF", "Off", "Fit all photographs"),
    ("AUTO", "Automatic", "Leave one photograph in eight out of the fit, evenly spaced and six at most"),
)
_SUBJECTS = (
    ("MESH", "Mesh", "Recover the maps of a mesh, in its UV map"),
    ("CARD", "Flat Card", "Recover the maps of a flat surface: the photographs' own pixels"),
)
_SLOTS = (
    ("ALL", "All", "All material slots of the mesh together: they share one set of maps and get one material"),
    ("ACTIVE", "Active", "Only the faces of the active material slot; the others still hide and shade them"),
    ("NAMED", "Chosen", "Only the faces of the slots named below; the others still hide and shade them"),
)
_SHOWN = (
    ("PARAMETER", "Map", "A recovered map"),
    ("ERROR", "Error", "How far the render is from the photographs: blue is close, red is far"),
    ("CONFIDENCE", "Uncertainty", "Standard deviation of a map: blue is certain, red is not"),
    ("RENDER", "Render", "The recovered material under the light of one observation"),
    ("REFERENCE", "Photograph", "The observation itself"),
    ("SPLIT", "Split", "Render on the left, photograph on the right"),
    ("BLINK", "Blink", "Render and photograph in turns"),
)


def model_of(settings: "Settings") -> ReflectanceModel:
    """Return the model that is chosen. Raises InputError."""
    if settings.model != CUSTOM:
        return load_model(settings.model)
    if not settings.model_path:
        raise InputError("Model: no file is chosen; give the .toml of your own model")
    return load_model(absolute(settings.model_path, "Model File"))


def refresh_parameters(settings: "Settings") -> None:
    """Bring the list of parameters in line with the model, keeping what was set for those that stay."""
    try:
        parameters = model_of(settings).parameters
    except InputError:
        parameters = ()
    former = {item.name: (item.recover, item.value, tuple(item.color), item.image) for item in settings.parameters}
    settings.parameters.clear()
    for parameter in parameters:
        item = settings.parameters.add()
        item.name, item.components, item.is_normal = parameter.name, parameter.components, parameter.is_normal
        recover, value, color, image = former.get(
            parameter.name, (True, parameter.default[0], (*parameter.default, 0, 0, 0)[:3], None)
        )
        item.recover, item.value, item.color, item.image = recover, value, color, image


def _model_changed(self, context) -> None:
    refresh_parameters(self)


def _observation_changed(self, context) -> None:
    REACTIONS["observation"](self)


def _skipping_changed(self, context) -> None:
    REACTIONS["skip_damaged"](self)


def _model_item(name: str) -> tuple[str, str, str]:
    """Return the entry of a shipped model: the short part of its title, and as its tooltip the long one."""
    short, _, long = load_model(name).title.partition(": ")
    return name, short, (long or short)[:1].upper() + (long or short)[1:]


_MODEL_ITEMS = [
    *(_model_item(name) for name in shipped_models()),
    (CUSTOM, "Own Model…", "A .toml that declares the parameters, with its .glsl beside it"),
]


def _parameter_items(self, context):
    _PARAMETER_ITEMS[:] = [(item.name, bpy.path.display_name(item.name), "") for item in self.id_data.irpso.parameters]
    return _PARAMETER_ITEMS or [("NONE", "None", "")]


_PARAMETER_ITEMS: list[tuple[str, str, str]] = []  # Blender keeps no reference to the texts of a dynamic enumeration


_AXIS_TEXT = "The searched number along this axis of the swarm's box; empty takes a colour, or what is searched first"


def _components(self, context, text: str) -> list[str]:
    """Return the names of the model's components, as swarms have them."""
    try:
        parameters = model_of(self.id_data.irpso).parameters
    except InputError:
        return []
    return [name for parameter in parameters for name in component_names(parameter)]


def _set_card_distance(self, value: float) -> None:
    self.card_distance = value


def _capture_changed(self, context) -> None:
    """Reset what belongs to the previous capture."""
    self.near_lights, self.stated_distance, self.card_distance = False, 0.0, 0.0


def _is_mesh(self, obj) -> bool:
    return obj.type == "MESH"


class FindingItem(bpy.types.PropertyGroup):
    """One thing that is wrong with a capture."""

    severity: StringProperty()
    code: StringProperty()
    message: StringProperty()
    ask: StringProperty(description="What it is an obstacle to, empty for everything")


class ParameterItem(bpy.types.PropertyGroup):
    """One parameter of the model: recovered, or given as a number, a colour or an image."""

    recover: BoolProperty(name="Recover", description="Find this map; otherwise it is taken as given", default=True)
    components: IntProperty(default=1)
    is_normal: BoolProperty()
    value: FloatProperty(
        name="Value", description="The number that is taken as given", default=0.5, soft_min=0, soft_max=1
    )
    color: FloatVectorProperty(
        name="Color", description="The colour that is taken as given", subtype="COLOR", size=3, default=(0.5, 0.5, 0.5),
        min=0,
    )  # fmt: skip
    image: PointerProperty(
        name="Image", type=bpy.types.Image, description="The map that is taken as given, instead of one value"
    )


class ViewSettings(bpy.types.PropertyGroup):
    """What is drawn over the viewport and the Image editor while a recovery runs."""

    show: BoolProperty(
        name="Show Maps", description="Draw the maps on the subject while they converge, where overlays are shown, and"
        " flat in Image editors that show no image or a recovered map", default=True,
    )  # fmt: skip
    shown: EnumProperty(name="Show", items=_SHOWN, default="PARAMETER")
    parameter: EnumProperty(name="Map", description="Which map is shown", items=_parameter_items)
    observation: IntProperty(
        name="Observation", description="Whose light and image are shown, counted from 1. Of the capture's lights in"
        " the scene only this one shines", min=1, default=1, update=_observation_changed,
    )  # fmt: skip
    split: FloatProperty(
        name="Split", description="Where the render ends and the photograph begins", subtype="FACTOR", min=0, max=1,
        default=0.5,
    )  # fmt: skip
    red_error: FloatProperty(
        name="Red At", description="The error that is drawn red, in % of white; 0 finds one", subtype="PERCENTAGE",
        min=0, soft_max=100, default=0, precision=2,
    )  # fmt: skip
    red_angle: FloatProperty(
        name="Red At", description="The standard deviation of a normal that is drawn red; 0 takes 10°", subtype="ANGLE",
        min=0, max=math.pi, default=0,
    )  # fmt: skip
    red_deviation: FloatProperty(
        name="Red At", description="The standard deviation that is drawn red, in the map's own unit; 0 takes a tenth of"
        " its range", min=0, soft_max=1, default=0, precision=3,
    )  # fmt: skip
    exposure: FloatProperty(name="Exposure", description="In stops, of render and photograph", soft_min=-5, soft_max=5)
    mark_unused: BoolProperty(
        name="Mark Unused Pixels", description="Draw diagonal stripes over the photograph's pixels that have no weight:"
        " clipped ones, and those taken for shadow", default=True,
    )  # fmt: skip
    mark_unknown: BoolProperty(
        name="Mark Unknown", description="Draw diagonal stripes over the map where the photographs do not tell its"
        " number: its standard deviation is over a quarter of its range. Shown once the recovery rests", default=True,
    )  # fmt: skip
    opacity: FloatProperty(name="Opacity", subtype="FACTOR", min=0, max=1, default=1)
    show_lights: BoolProperty(name="Lights", description="Draw the dome of lights around the subject", default=True)
    show_cameras: BoolProperty(name="Cameras", description="Draw the capture's cameras", default=True)
    dome_radius: FloatProperty(
        name="Dome Radius", description="How far away distant lights are drawn; 0 fits the subject", min=0, default=0,
        subtype="DISTANCE",
    )  # fmt: skip
    show_curves: BoolProperty(
        name="Error Curves", description="Draw the error of probed texels against the iterations", default=True
    )
    show_swarm: BoolProperty(
        name="Swarm", description="Draw the particles of the chosen probe in the space that they search", default=False
    )
    probe: IntProperty(name="Probe", description="The probe whose swarm is drawn, from 1", min=1, max=4, default=1)
    swarm_x: StringProperty(name="X", description=_AXIS_TEXT, search=_components)
    swarm_y: StringProperty(name="Y", description=_AXIS_TEXT, search=_components)
    swarm_z: StringProperty(name="Z", description=_AXIS_TEXT, search=_components)
    goal: PointerProperty(
        name="True Map", type=bpy.types.Image,
        description="Where the truth is known, as in a test: the map that should be found, of the first axis' own."
        " The swarm's goal is drawn from it",
    )  # fmt: skip

    def index(self, count: int) -> int:
        """Return the index, from 0, of the chosen one of so many observations."""
        return max(min(self.observation, count), 1) - 1


class Settings(bpy.types.PropertyGroup):
    """All that a recovery needs to know of a scene."""

    source: EnumProperty(name="Capture From", items=_SOURCES, default="FILES")
    capture_path: StringProperty(
        name="Capture", description="Folder of photographs with their lights, an .lp list or a capture.toml",
        subtype="FILE_PATH", update=_capture_changed, **RELATIVE_PATH,
    )  # fmt: skip
    colour_space: EnumProperty(
        name="Color Space",
        description="Of the capture's image files; with This Scene each image's own Color Space counts",
        items=_COLOUR_SPACES,
    )
    skip_damaged: BoolProperty(
        name="Leave Out Damaged Images", description="Go on without images that are missing or cannot be decoded: each"
        " is decoded once to find out", update=_skipping_changed,
    )  # fmt: skip
    light_strengths: EnumProperty(
        name="Light Strengths", description="Whether the capture's light intensities are known", items=_STRENGTHS
    )
    refine_directions: FloatProperty(
        name="Refine Lights", description="How far off the lights' directions may be: they are corrected by the"
        " photographs before the search. 0 leaves them as they are", subtype="ANGLE", min=0,
        max=math.radians(MOST_DEGREES), default=0,
    )  # fmt: skip
    hold_out: EnumProperty(
        name="Hold Out", description="Test the maps on photographs that they were not fitted to: some are left out of"
        " the recovery, relit from its maps, and compared when it ends", items=_HOLD_OUT, default="OFF",
    )  # fmt: skip
    checked_path: StringProperty(description="The capture that the findings are of")
    summary: StringProperty(description="What the capture holds")
    findings: CollectionProperty(type=FindingItem)
    subject: EnumProperty(name="Subject", items=_SUBJECTS, default="CARD")
    object: PointerProperty(
        name="Object", description="The mesh whose maps are recovered; empty takes the active one",
        type=bpy.types.Object, poll=_is_mesh,
    )  # fmt: skip
    card_distance: FloatProperty(
        name="Card Distance", description="From the camera to the card, along the camera's axis, in the unit of the"
        " lights' places. 0 takes card_distance of the capture.toml", min=0, soft_max=10_000, default=0, precision=4,
    )  # fmt: skip
    card_length: FloatProperty(
        name="Card Distance", description="From the camera to the card, along the camera's axis", min=0,
        subtype="DISTANCE", get=lambda self: self.card_distance, set=_set_card_distance,
    )  # fmt: skip
    near_lights: BoolProperty(description="Whether lights of the files have places")
    stated_distance: FloatProperty(description="card_distance of the capture.toml, 0 where it has none")
    slots: EnumProperty(name="Slots", description="Which material slots are recovered", items=_SLOTS, default="ALL")
    slot_list: StringProperty(
        name="Slots", description="Names of material slots, or their numbers from 0, separated by commas"
    )
    resolution: IntProperty(
        name="Resolution", description="Texels along a side of the mesh's maps, of each UDIM tile where there are"
        " several; a card's maps have the images' size",
        subtype="PIXEL", min=1, max=_LARGEST_SIDE, soft_min=64, soft_max=4096, default=512,
    )  # fmt: skip
    shadows: BoolProperty(
        name="Predict Shadows", description="Leave out of the photographs what the mesh hides from the light; switch it"
        " off where the mesh is rougher than its subject", default=True,
    )  # fmt: skip
    model: EnumProperty(
        name="Model", description="What is recovered", items=_MODEL_ITEMS, default=DEFAULT_MODEL, update=_model_changed
    )
    model_path: StringProperty(
        name="Model File", description="A .toml that declares the parameters, with its .glsl beside it",
        subtype="FILE_PATH", update=_model_changed, **RELATIVE_PATH,
    )  # fmt: skip
    parameters: CollectionProperty(type=ParameterItem)
    schedule: PointerProperty(type=ScheduleSettings)
    seed: IntProperty(name="Seed", description="Of the random numbers: the same seed gives the same maps")
    view: PointerProperty(type=ViewSettings)
    displacement: BoolProperty(
        name="Displacement", description="Have the material that Keep makes displace the surface by the relief."
        " The mesh has to be fine enough to show it: add a Subdivision Surface modifier",
    )  # fmt: skip


class ObservationSettings(bpy.types.PropertyGroup):
    """The photograph that was taken under a light."""

    image: PointerProperty(
        name="Photograph", description="The image that was taken under this light", type=bpy.types.Image
    )
    camera: PointerProperty(
        name="Camera", description="The camera that took it; empty takes the scene's", type=bpy.types.Object,
        poll=lambda self, obj: obj.type == "CAMERA",
    )  # fmt: skip


CLASSES = (FindingItem, ParameterItem, ViewSettings, Settings, ObservationSettings)


def register() -> None:
    """Give scenes and objects their settings."""
    bpy.types.Scene.irpso = PointerProperty(type=Settings)
    bpy.types.Object.irpso = PointerProperty(type=ObservationSettings)


def unregister() -> None:
    """Take the settings away; what is stored in the .blend stays there."""
    del bpy.types.Object.irpso
    del bpy.types.Scene.irpso
