"""Heights from recovered normals: the relief of a card, the detail on a mesh."""
