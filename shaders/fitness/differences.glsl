// A material moved along one of its unknowns, for derivatives of whatever model by differences.
//
// free_parameters.glsl is generated: void free_at(int u, out int component, out float low, out float width).
// FREE_COUNT are counted, the normal as two that follow each other from NORMAL_FREE on (−1 where it was given);
// NORMAL_COMPONENT is where it lies in the estimates.

#include "material.glsl"
#include "free_parameters.glsl"

// Steps of the differences, of a parameter's range. Rounding leaves about 2⁻²⁵ / 2⁻¹¹ = 2⁻¹⁴ of the radiance.
#define STEP (1.0 / 1024.0)
#define DIFFERENCE_ROUNDING (1.0 / 16384.0)

// A unit normal moved by two angles in its tangent plane. tan stands for the angle.
vec3 turned_normal(vec3 n, vec2 angles)
{
    // Any axes will do: nothing that is made of both depends on them.
    vec3 axis = normalize(cross(n, abs(n.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0)));
    n += angles.x * axis + angles.y * cross(n, axis);
    return n * inversesqrt(1.0 + dot(angles, angles));
}

// The material, changed by moving unknown u by a fraction of its range; it stays inside, as everything that is tried.
Material moved(inout float given[12], int u, float by)
{
    // A copy: arrays go by reference everywhere in these shaders, since Metal has no arrays by value.
    float c[12];
    for (int i = 0; i < 12; i++) {
        c[i] = given[i];
    }
    int at;
    float low;
    float width;
    free_at(u, at, low, width);
#if NORMAL_FREE >= 0
    if (u == NORMAL_FREE || u == NORMAL_FREE + 1) {
        vec3 n = vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]);
        float angle = by * width;
        n = turned_normal(n, u == NORMAL_FREE ? vec2(angle, 0.0) : vec2(0.0, angle));
        c[NORMAL_COMPONENT] = n.x;
        c[NORMAL_COMPONENT + 1] = n.y;
        c[NORMAL_COMPONENT + 2] = n.z;
        return material_from(c);
    }
#endif
    c[at] = clamp(c[at] + by * width, low, low + width);
    return material_from(c);
}

// How far unknown u may go down and up, in fractions of its range; a normal may go anywhere.
vec2 room_of(inout float c[12], int u)
{
    int at;
    float low;
    float width;
    free_at(u, at, low, width);
#if NORMAL_FREE >= 0
    if (u == NORMAL_FREE || u == NORMAL_FREE + 1) {
        return vec2(-1.0, 1.0);
    }
#endif
    float x = (c[at] - low) / width;
    return vec2(-x, 1.0 - x);
}

// How far a difference steps: away from the nearer end of the range.
float stride_of(inout float c[12], int u)
{
    vec2 room = room_of(c, u);
    return room.y >= -room.x ? STEP : -STEP;
}
