// In place of shared.glsl: only neighbours have votes.

float votes_of_materials(inout float c[12])
{
    return 0.0;
}
