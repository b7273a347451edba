// Perturbs one free parameter of a material, for derivatives by finite differences.
//
// free_parameters.glsl is generated. solver/kernels/free_parameters.py lists its declarations.

#include "material.glsl"
#include "free_parameters.glsl"

// Step, as a fraction of a parameter's range. Rounding adds an error of about 2⁻²⁵ / 2⁻¹¹ = 2⁻¹⁴ of the radiance.
#define STEP (1.0 / 1024.0)
#define DIFFERENCE_ROUNDING (1.0 / 16384.0)

// Returns the first of the two tangent axes along which a normal turns. The second is cross(n, axis). The choice is
// arbitrary: results that use both axes do not depend on it.
vec3 turning_axis(vec3 n)
{
    return normalize(cross(n, abs(n.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0)));
}

// Turns a unit normal by two angles in its tangent plane. The angle is taken for its tangent.
vec3 turned_normal(vec3 n, vec2 angles)
{
    vec3 axis = turning_axis(n);
    n += angles.x * axis + angles.y * cross(n, axis);
    return n * inversesqrt(1.0 + dot(angles, angles));
}

// Returns the material with free parameter u changed by a fraction of its range and clamped to the range.
Material moved(inout float unmoved[MAX_COMPONENTS], int u, float fraction)
{
    // A copy is needed: these shaders pass arrays as inout, because Metal cannot pass them by value.
    float c[MAX_COMPONENTS];
    for (int i = 0; i < MAX_COMPONENTS; i++) {
        c[i] = unmoved[i];
    }
    FreeParameter free = free_at(u);
#if NORMAL_FREE >= 0
    if (is_normal(u)) {
        vec3 n = vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]);
        float angle = fraction * free.width;
        n = turned_normal(n, u == NORMAL_FREE ? vec2(angle, 0.0) : vec2(0.0, angle));
        c[NORMAL_COMPONENT] = n.x;
        c[NORMAL_COMPONENT + 1] = n.y;
        c[NORMAL_COMPONENT + 2] = n.z;
        return material_from(c);
    }
#endif
    c[free.at] = clamp(c[free.at] + fraction * free.width, free.low, free.low + free.width);
    return material_from(c);
}

// Returns the lowest and highest step of free parameter u, as fractions of its range. A normal is unbounded: (−1, 1).
vec2 step_bounds(inout float c[MAX_COMPONENTS], int u)
{
    FreeParameter free = free_at(u);
    if (is_normal(u)) {
        return vec2(-1.0, 1.0);
    }
    float x = (c[free.at] - free.low) / free.width;
    return vec2(-x, 1.0 - x);
}

// Returns the step of a one-sided difference. It points away from the nearer end of the range.
float stride_of(inout float c[MAX_COMPONENTS], int u)
{
    vec2 bounds = step_bounds(c, u);
    return bounds.y >= -bounds.x ? STEP : -STEP;
}
