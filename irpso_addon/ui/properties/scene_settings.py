"""Settings stored in the .blend: those of the scene and of the view, and each light's photograph."""

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
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)

from ...core.errors import InputError
from ...core.paths import DEFAULT_MODEL
from ...reflectance.model import ReflectanceModel, load_model
from ...solver.lights.refine import MAX_DEGREES
from ...solver.views.texel_probe import component_names
from ..common.features import RELATIVE_PATH
from ..common.file_paths import absolute
from .model_items import CUSTOM, MODEL_ITEMS
from .schedule_settings import ScheduleSettings

UPDATE_CALLBACKS: dict[
    str, Callable[[bpy.types.PropertyGroup], None]
] = {}  # setting → the operators' function on its change
_MAX_SIDE = 16384
_COLOUR_SPACES = (
    ("auto", "Automatic", "8-bit images are sRGB unless file or pixels show that they are linear; others are linear"),
    ("srgb", "sRGB", "All images are sRGB, like a camera's JPEG"),
    ("linear", "Linear", "All images hold linear radiance"),
)
_SOURCES = (
    ("FILES", "Files", "A folder of photographs with their lights, an .lp list or a capture.toml"),
    ("SCENE", "This Scene", "The cameras and lights of the open file, each light with its image"),
)
_FRAMINGS = (
    ("FILE", "As Imported", "The whole photographs, or the part that the capture.toml names"),
    ("CROP", "Crop", "A rectangle of the photographs"),
    ("CORNERS", "Corners", "A flat card that was photographed at an angle, shown straight from the front"),
)
_STRENGTHS = (
    (
        "AUTO",
        "Automatic",
        "As given. Estimated if the capture gives none and the photographs contradict equal strengths",
    ),
    ("GIVEN", "As Given", "Light strengths of the capture or the scene; 1 if it gives none"),
    ("ESTIMATE", "Estimate", "Estimate each light's strength from the photographs before the search, up to one scale"),
)
_HOLD_OUT = (
    ("OFF", "Off", "Fit all photographs"),
    ("AUTO", "Automatic", "Fit without one photograph in eight, evenly spaced, six at most"),
)
_SUBJECTS = (
    ("MESH", "Mesh", "Recover the maps of a mesh, in its UV map"),
    ("CARD", "Flat Card", "Recover the maps of a flat surface, at the photographs' own pixels"),
)
_SLOTS = (
    ("ALL", "All", "All material slots of the mesh: they share one set of maps and one material"),
    ("ACTIVE", "Active", "Only the faces of the active material slot. The other faces still hide and shadow them"),
    ("NAMED", "Chosen", "Only the faces of the slots named below. The other faces still hide and shadow them"),
)
_SHOWN = (
    ("PARAMETER", "Map", "A recovered map"),
    ("ERROR", "Error", "Difference between render and photographs: blue is small, red is large"),
    ("CONFIDENCE", "Uncertainty", "Standard deviation of a map: blue is certain, red is uncertain"),
    (
        "INDIRECT",
        "Indirect Light",
        "The part of the photographed light that other parts of the subject sent: blue is none, red is two thirds or"
        " more. Interreflection finds it",
    ),
    ("RENDER", "Render", "The recovered material under the light of one photograph"),
    ("REFERENCE", "Photograph", "The photograph itself"),
    ("SPLIT", "Split", "Render on the left, photograph on the right"),
    ("BLINK", "Blink", "Render and photograph alternately"),
)


def model_of(settings: "Settings") -> ReflectanceModel:
    """Return the chosen model. Raises InputError."""
    return load_model(model_source(settings))


def model_source(settings: "Settings") -> str:
    """Return the name of the chosen shipped model, or the path of the user's. Raises InputError without one."""
    if settings.model != CUSTOM:
        return settings.model
    if not settings.model_path:
        raise InputError("Model: no file is chosen; give the .toml of your own model")
    return str(absolute(settings.model_path, "Model File"))


def refresh_parameters(settings: "Settings", context: object = None) -> None:
    """Fill the list of parameters from the model. Parameters that stay keep their settings, and the view its map."""
    try:
        parameters = model_of(settings).parameters
    except InputError:
        parameters = ()
    former = {item.name: (item.recover, item.value, tuple(item.color), item.image) for item in settings.parameters}
    shown = settings.view.parameter
    settings.parameters.clear()
    for parameter in parameters:
        item = settings.parameters.add()
        item.name, item.components, item.is_normal = parameter.name, parameter.components, parameter.is_normal
        recover, value, color, image = former.get(
            parameter.name, (True, parameter.default[0], (*parameter.default, 0, 0, 0)[:3], None)
        )
        item.recover, item.value, item.color, item.image = recover, value, color, image
    if parameters:  # the view stores a place in the list
        settings.view.parameter = shown if shown in settings.parameters else parameters[0].name


def _parameter_items(self, context):
    _PARAMETER_ITEMS[:] = [(item.name, bpy.path.display_name(item.name), "") for item in self.id_data.irpso.parameters]
    return _PARAMETER_ITEMS or [("NONE", "None", "")]


_PARAMETER_ITEMS: list[tuple[str, str, str]] = []  # a reference to the texts, because Blender holds none


_AXIS_TEXT = "The parameter along this axis of the swarm's box. Empty: a color, or the first searched parameters"


def _components(self, context, text: str) -> list[str]:
    """Return the names of the components of the model's parameters."""
    try:
        parameters = model_of(self.id_data.irpso).parameters
    except InputError:
        return []
    return [name for parameter in parameters for name in component_names(parameter)]


def _capture_changed(self, context) -> None:
    """Reset the settings of the previous capture."""
    self.near_lights, self.framing, self.picture_scale = False, "FILE", 1.0
    self.stated_distance = self.stated_width = self.card_distance = self.card_width = 0.0
    self.chart_photograph, self.chart_corners = "", (0.0,) * 8


class FindingItem(bpy.types.PropertyGroup):
    """One fault of a capture."""

    severity: StringProperty()
    code: StringProperty()
    message: StringProperty()
    goal: StringProperty(description="The maps that it prevents, empty for all")


class ParameterItem(bpy.types.PropertyGroup):
    """One parameter of the model: recovered, or fixed to a number, a color or an image."""

    recover: BoolProperty(
        name="Recover", description="Recover this map. If off, it is fixed to the value or image below", default=True
    )
    components: IntProperty(default=1)
    is_normal: BoolProperty()
    value: FloatProperty(name="Value", description="The fixed value of this map", default=0.5, soft_min=0, soft_max=1)
    color: FloatVectorProperty(
        name="Color", description="The fixed color of this map", subtype="COLOR", size=3, default=(0.5, 0.5, 0.5),
        min=0,
    )  # fmt: skip
    image: PointerProperty(
        name="Image", type=bpy.types.Image, description="An image with the fixed map, instead of one value"
    )


class ViewSettings(bpy.types.PropertyGroup):
    """Settings of the overlay in the viewport and the Image editor."""

    show: BoolProperty(
        name="Show Maps", description="Draw the converging maps on the subject in viewports with overlays on, and flat"
        " in Image editors that show no image or a recovered map", default=True,
    )  # fmt: skip
    shown: EnumProperty(name="Show", description="What is drawn on the subject", items=_SHOWN, default="PARAMETER")
    parameter: EnumProperty(name="Map", description="Which map is shown", items=_parameter_items)
    observation: IntProperty(
        name="Photograph", description="Number of the photograph to show, from 1, with its light. The capture's other"
        " lights in the scene are switched off", min=1, default=1,
        update=lambda self, context: UPDATE_CALLBACKS["observation"](self),
    )  # fmt: skip
    split: FloatProperty(
        name="Split", description="Where the render ends and the photograph begins", subtype="FACTOR", min=0, max=1,
        default=0.5,
    )  # fmt: skip
    red_error: FloatProperty(
        name="Red At", description="The error that is drawn red, in % of white. 0: automatic", subtype="PERCENTAGE",
        min=0, soft_max=100, default=0, precision=2,
    )  # fmt: skip
    red_angle: FloatProperty(
        name="Red At", description="The standard deviation of a normal that is drawn red. 0: 10°", subtype="ANGLE",
        min=0, max=math.pi, default=0,
    )  # fmt: skip
    red_deviation: FloatProperty(
        name="Red At", description="The standard deviation that is drawn red, in the map's own unit. 0: a tenth of its"
        " range", min=0, soft_max=1, default=0, precision=3,
    )  # fmt: skip
    exposure: FloatProperty(
        name="Exposure",
        description="Exposure of render and photograph, in stops. More is brighter",
        soft_min=-5,
        soft_max=5,
    )
    mark_unused: BoolProperty(
        name="Mark Unused Pixels", description="Draw diagonal stripes over the photograph's pixels with no weight:"
        " clipped or in shadow", default=True,
    )  # fmt: skip
    mark_unknown: BoolProperty(
        name="Mark Unknown", description="Draw diagonal stripes over the map where the photographs do not determine it:"
        " its standard deviation exceeds a quarter of its range. Not shown while the recovery runs", default=True,
    )  # fmt: skip
    opacity: FloatProperty(
        name="Opacity",
        description="Opacity of the drawn picture over the viewport. 0 shows the viewport alone",
        subtype="FACTOR",
        min=0,
        max=1,
        default=1,
    )
    show_lights: BoolProperty(name="Lights", description="Draw the dome of lights around the subject", default=True)
    show_cameras: BoolProperty(name="Cameras", description="Draw the capture's cameras", default=True)
    dome_radius: FloatProperty(
        name="Dome Radius", description="Distance at which distant lights are drawn. 0 fits the subject", min=0,
        default=0, subtype="DISTANCE",
    )  # fmt: skip
    show_curves: BoolProperty(
        name="Error Curves", description="Plot the error of probed texels over the iterations", default=True
    )
    show_swarm: BoolProperty(
        name="Swarm", description="Draw the particles of the chosen probe in their search space", default=False
    )
    probe: IntProperty(name="Probe", description="The probe whose swarm is drawn, from 1", min=1, max=4, default=1)
    swarm_x: StringProperty(name="X", description=_AXIS_TEXT, search=_components)
    swarm_y: StringProperty(name="Y", description=_AXIS_TEXT, search=_components)
    swarm_z: StringProperty(name="Z", description=_AXIS_TEXT, search=_components)
    goal: PointerProperty(
        name="True Map", type=bpy.types.Image,
        description="For tests with a known result: the true map of the first axis' parameter. The swarm's goal is"
        " drawn from it",
    )  # fmt: skip

    def index(self, count: int) -> int:
        """Return the index, from 0, of the chosen observation, limited to ``count`` observations."""
        return max(min(self.observation, count), 1) - 1


class Settings(bpy.types.PropertyGroup):
    """All settings of a recovery."""

    source: EnumProperty(
        name="Capture From",
        description="Where the photographs and their lights come from",
        items=_SOURCES,
        default="FILES",
    )
    capture_path: StringProperty(
        name="Capture", description="Folder of photographs with their lights, an .lp list or a capture.toml",
        subtype="FILE_PATH", update=_capture_changed, **RELATIVE_PATH,
    )  # fmt: skip
    colour_space: EnumProperty(
        name="Color Space", items=_COLOUR_SPACES, update=lambda self, context: UPDATE_CALLBACKS["colour_space"](self),
        description="Color space of the capture's image files. This Scene uses each image's own Color Space",
    )  # fmt: skip
    skip_damaged: BoolProperty(
        name="Leave Out Damaged Images", description="Recover without images that are missing or cannot be decoded. The"
        " check decodes every image once", update=lambda self, context: UPDATE_CALLBACKS["skip_damaged"](self),
    )  # fmt: skip
    light_strengths: EnumProperty(
        name="Light Strengths", description="Source of the lights' strengths", items=_STRENGTHS
    )
    refine_directions: FloatProperty(
        name="Refine Lights", description="Typical error (standard deviation) of the lights' directions. The"
        " photographs correct them before the search. 0: no correction", subtype="ANGLE", min=0,
        max=math.radians(MAX_DEGREES), default=0,
    )  # fmt: skip
    hold_out: EnumProperty(
        name="Hold Out", description="Test the maps on photographs that the fit has not used: some are left out of the"
        " recovery. When it ends, renders of its maps are compared with them", items=_HOLD_OUT, default="OFF",
    )  # fmt: skip
    checked_path: StringProperty(description="The capture of the findings")
    paths_base: StringProperty(description="Folder that relative paths of these settings start from")
    summary: StringProperty(description="Facts about the capture")
    checked_images: IntProperty(description="Number of images of the checked capture")
    checked_texels: IntProperty(description="Texels of the checked capture as a card")
    findings: CollectionProperty(type=FindingItem)
    subject: EnumProperty(name="Subject", description="What the photographs show", items=_SUBJECTS, default="CARD")
    object: PointerProperty(
        name="Object", description="The mesh whose maps are recovered. Empty: the active object",
        type=bpy.types.Object, poll=lambda self, obj: obj.type == "MESH",
    )  # fmt: skip
    occluders: PointerProperty(
        name="Occluders", description="A collection of objects around the mesh, such as a table or a holder. They hide"
        " it from cameras and lights and block the light that it throws on itself; they reflect none and are not"
        " recovered. The mesh itself, lights and cameras in it do not count", type=bpy.types.Collection,
    )  # fmt: skip
    card_distance: FloatProperty(
        name="Card Distance", description="Distance from the camera to the card, along the camera's axis, in the"
        " unit of the light positions. 0: card_distance of the capture.toml", min=0, soft_max=10_000, default=0,
        precision=4,
    )  # fmt: skip
    framing: EnumProperty(name="Frame", description="The part of the photographs that is recovered", items=_FRAMINGS)
    crop: IntVectorProperty(
        name="X, Y, Width, Height", description="In pixels, from the upper left corner of the photographs", size=4,
        min=0,
    )  # fmt: skip
    corners: FloatVectorProperty(
        name="Corners", description="X and Y of the card's corners, clockwise from its upper left one, in pixels from"
        " the upper left corner of the photographs", size=8, min=0, precision=1,
    )  # fmt: skip
    chart_photograph: StringProperty(
        name="Chart", description="Photograph of the 24-patch chart, in the light and with the settings of the others."
        " Empty: the capture's own", subtype="FILE_PATH", **RELATIVE_PATH,
    )  # fmt: skip
    chart_corners: FloatVectorProperty(
        name="Chart Corners", description="X and Y of the corners of the chart's patches, in pixels from the upper left"
        " corner of the photograph", size=8, min=0, precision=1,
    )  # fmt: skip
    picture_scale: FloatProperty(
        name="Scale", description="Size of the photographs, and so of a card's maps. 0.25 is a quick preview", min=0.01,
        max=1, default=1, precision=2,
    )  # fmt: skip
    card_width: FloatProperty(
        name="Card Width", description="Width of the card as it is shown, in the unit of the light positions: gives its"
        " distance from the camera. 0: unknown", min=0, soft_max=10_000, default=0, precision=4,
    )  # fmt: skip
    card_length: FloatProperty(
        name="Card Distance", description="Distance from the camera to the card, along the camera's axis", min=0,
        subtype="DISTANCE", get=lambda self: self.card_distance,
        set=lambda self, value: setattr(self, "card_distance", value),
    )  # fmt: skip
    near_lights: BoolProperty(description="Whether the files give positions of lights")
    stated_distance: FloatProperty(description="card_distance of the capture.toml, 0 if it has none")
    stated_width: FloatProperty(description="card_width of the capture.toml, 0 if it has none")
    slots: EnumProperty(name="Slots", description="Which material slots are recovered", items=_SLOTS, default="ALL")
    slot_list: StringProperty(
        name="Slots", description="Names of material slots, or their numbers from 0, separated by commas"
    )
    resolution: IntProperty(
        name="Resolution", description="Texels along each side of the mesh's maps, per UDIM tile. A card's maps have"
        " the size of the images",
        subtype="PIXEL", min=1, max=_MAX_SIDE, soft_min=64, soft_max=4096, default=512,
    )  # fmt: skip
    shadows: BoolProperty(
        name="Predict Shadows", description="Ignore the photographs' pixels where the mesh shadows itself. Switch it"
        " off if the mesh is rougher than the real subject", default=True,
    )  # fmt: skip
    model: EnumProperty(
        name="Model",
        description="How the surface reflects light, and so which maps are recovered",
        items=MODEL_ITEMS,
        default=DEFAULT_MODEL,
        update=refresh_parameters,
    )
    model_path: StringProperty(
        name="Model File", description="A .toml that declares the parameters, with its .glsl beside it",
        subtype="FILE_PATH", update=refresh_parameters, **RELATIVE_PATH,
    )  # fmt: skip
    parameters: CollectionProperty(type=ParameterItem)
    schedule: PointerProperty(type=ScheduleSettings)
    seed: IntProperty(name="Seed", description="Seed of the random numbers: the same seed gives the same maps")
    view: PointerProperty(type=ViewSettings)
    displacement: BoolProperty(
        name="Displacement", description="Keep adds displacement by the recovered relief to the material. The mesh must"
        " be fine enough to show it: add a Subdivision Surface modifier",
    )  # fmt: skip


class ObservationSettings(bpy.types.PropertyGroup):
    """A light's photograph and its camera."""

    image: PointerProperty(name="Photograph", description="The photograph taken under this light", type=bpy.types.Image)
    camera: PointerProperty(
        name="Camera", description="The photograph's camera. Empty: the scene's camera", type=bpy.types.Object,
        poll=lambda self, obj: obj.type == "CAMERA",
    )  # fmt: skip


CLASSES = (FindingItem, ParameterItem, ViewSettings, Settings, ObservationSettings)


def register() -> None:
    """Add the settings to scenes and objects."""
    bpy.types.Scene.irpso = PointerProperty(type=Settings)
    bpy.types.Object.irpso = PointerProperty(type=ObservationSettings)


def unregister() -> None:
    """Remove the settings from Blender. The values in the .blend stay."""
    del bpy.types.Object.irpso
    del bpy.types.Scene.irpso
