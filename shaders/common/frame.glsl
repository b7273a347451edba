// Position of a texel and the orthonormal tangent frame of its material. Reads u_geometry.

#include "common/geometry.glsl"

// States of a texel, stored in GEOMETRY_POSITION.w.
#define TEXEL_OUTSIDE 0
#define TEXEL_SOLVED 1
#define TEXEL_HALO 2
#define TEXEL_SEPARATED 4 // added to the state where the indirect light was subtracted from the samples

struct Frame {
    vec3 position;
    vec3 tangent;
    vec3 bitangent;
    vec3 normal;
};

int state_at(ivec2 texel)
{
    return int(geometry_at(GEOMETRY_POSITION, texel).w) & (TEXEL_SEPARATED - 1);
}

bool separated_at(ivec2 texel)
{
    return (int(geometry_at(GEOMETRY_POSITION, texel).w) & TEXEL_SEPARATED) != 0;
}

// Returns the texel's scale: a percentile of its radiance per light intensity (solver/settings/groups.py, Fitness).
float radiance_scale_at(ivec2 texel)
{
    return geometry_at(GEOMETRY_NORMAL, texel).w;
}

// shadow_at() of separated texels.
#define SEPARATED_SHADOW 0.02

// Returns the shadow limit, a fraction of the scale: darker samples count as shadow. 0 where the light is not indirect.
float shadow_at(ivec2 texel)
{
    return abs(geometry_at(GEOMETRY_TANGENT, texel).w) - 1.0;
}

Frame frame_at(ivec2 texel)
{
    Frame f;
    f.position = geometry_at(GEOMETRY_POSITION, texel).xyz;
#ifdef CARD
    // On a card the frames of world, camera and texel coincide.
    f.tangent = vec3(1.0, 0.0, 0.0);
    f.bitangent = vec3(0.0, 1.0, 0.0);
    f.normal = vec3(0.0, 0.0, 1.0);
#else
    vec4 tangent = geometry_at(GEOMETRY_TANGENT, texel);
    f.normal = geometry_at(GEOMETRY_NORMAL, texel).xyz;
    f.tangent = tangent.xyz;
    f.bitangent = sign(tangent.w) * cross(f.normal, f.tangent);
#endif
    return f;
}

vec3 to_local(Frame f, vec3 d)
{
#ifdef CARD
    return d;
#else
    return vec3(dot(d, f.tangent), dot(d, f.bitangent), dot(d, f.normal));
#endif
}

vec3 to_world(Frame f, vec3 d)
{
#ifdef CARD
    return d;
#else
    return d.x * f.tangent + d.y * f.bitangent + d.z * f.normal;
#endif
}
