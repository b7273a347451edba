// A material moved along one free parameter, for derivatives by differences.
//
// free_parameters.glsl is generated: solver/kernels/free_parameters.py says what it declares.

#include "material.glsl"
#include "free_parameters.glsl"

// Steps, as fractions of a parameter's range. Rounding leaves an error of about 2⁻²⁵ / 2⁻¹¹ = 2⁻¹⁴ of the radiance.
#define STEP (1.0 / 1024.0)
#define DIFFERENCE_ROUNDING (1.0 / 16384.0)

// The first of the two axes along which a normal turns; the second is cross(n, axis). Any axes will do: no result that
// uses both depends on them.
vec3 turning_axis(vec3 n)
{
    return normalize(cross(n, abs(n.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0)));
}

// A unit normal turned by two angles in its tangent plane; tan approximates the angle.
vec3 turned_normal(vec3 n, vec2 angles)
{
    vec3 axis = turning_axis(n);
    n += angles.x * axis + angles.y * cross(n, axis);
    return n * inversesqrt(1.0 + dot(angles, angles));
}

// The material with free parameter u moved by a fraction of its range, and clamped to it.
Material moved(inout float given[12], int u, float by)
{
    // A copy: these shaders pass arrays by reference, because Metal cannot pass them by value.
    float c[12];
    for (int i = 0; i < 12; i++) {
        c[i] = given[i];
    }
    FreeParameter free = free_at(u);
#if NORMAL_FREE >= 0
    if (is_normal(u)) {
        vec3 n = vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]);
        float angle = by * free.width;
        n = turned_normal(n, u == NORMAL_FREE ? vec2(angle, 0.0) : vec2(0.0, angle));
        c[NORMAL_COMPONENT] = n.x;
        c[NORMAL_COMPONENT + 1] = n.y;
        c[NORMAL_COMPONENT + 2] = n.z;
        return material_from(c);
    }
#endif
    c[free.at] = clamp(c[free.at] + by * free.width, free.low, free.low + free.width);
    return material_from(c);
}

// How far free parameter u may go down and up, as fractions of its range; a normal is unbounded.
vec2 room_of(inout float c[12], int u)
{
    FreeParameter free = free_at(u);
    if (is_normal(u)) {
        return vec2(-1.0, 1.0);
    }
    float x = (c[free.at] - free.low) / free.width;
    return vec2(-x, 1.0 - x);
}

// The step of a difference: away from the nearer end of the range.
float stride_of(inout float c[12], int u)
{
    vec2 room = room_of(c, u);
    return room.y >= -room.x ? STEP : -STEP;
}
