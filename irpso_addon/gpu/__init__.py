"""The only folder that imports Blender's gpu module: context, textures, shader library, passes."""
