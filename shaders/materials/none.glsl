// Replaces shared.glsl where the surface has no shared materials: only neighbours vote.

float votes_of_materials(inout float c[12])
{
    return 0.0;
}
