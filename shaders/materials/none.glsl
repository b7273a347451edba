// Replaces shared.glsl where the surface has no shared materials: only neighbours support a material.

float material_support_of(inout float c[MAX_COMPONENTS])
{
    return 0.0;
}
