"""The export formats: names, titles and conventions, for command line and panel, without the writers."""

WEB = "web"  # of a flat card alone
FORMATS = {  # name: (title, description)
    "gltf": ("glTF", "One .glb file: the mesh with the maps, for web viewers and game engines"),
    "openlime": ("OpenLIME", "Images of a BRDF layer with a Ward lobe, for OpenLIME's viewer"),
    "ptm": ("PTM", "Polynomial texture map, which RTI viewers show under any light"),
    WEB: ("Web Page", "A folder with a page that relights a flat card in any browser, without a network"),
    "textures": ("Textures", "PNG files with the names that another program expects"),
}
ONE_FILE = {"gltf": ".glb", "ptm": ".ptm"}  # the others are folders
OCCLUDED = ("gltf", "textures")  # they have occlusion
ASSET = "asset"  # a material in an asset library: command line only; the panel has a dialog for it
TURNTABLE = "turntable"  # a strip of pictures: command line only
RELIEF = "relief"  # a card's relief as a solid: command line only
