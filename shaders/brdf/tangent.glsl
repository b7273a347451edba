// Directions along and across the grain of an anisotropic surface.

struct Grain {
    vec3 along;
    vec3 across; // n × along
};

// Returns the x axis of the texel's frame, made perpendicular to n: the tangent of Blender's UV map on a mesh, the
// image's x on a card. If n is the x axis, the y axis replaces it.
Grain grain_of(vec3 n)
{
    // n × x, without cancellation even where n is nearly x.
    float squared = n.y * n.y + n.z * n.z;
    Grain g;
    g.across = squared > 1e-30 ? vec3(0.0, n.z, -n.y) * inversesqrt(squared) : vec3(0.0, 0.0, 1.0);
    g.along = cross(g.across, n);
    return g;
}

// Returns the grain turned about n by θ. twice: a vector of any length along (cos 2θ, sin 2θ); 0 does not turn. A grain
// turned by half a turn is the same grain.
Grain turned_grain(Grain g, vec2 twice)
{
    float squared = dot(twice, twice);
    vec2 d = squared > 1e-30 ? twice * inversesqrt(squared) : vec2(1.0, 0.0);
    // cos² θ = (1 + cos 2θ) / 2 and sin 2θ = 2 sin θ cos θ, computed from the larger of cos θ and sin θ.
    float large = sqrt(0.5 + 0.5 * abs(d.x));
    float small = 0.5 * abs(d.y) / large;
    vec2 half_turn = d.x >= 0.0 ? vec2(large, small) : vec2(small, large);
    if (d.y < 0.0) {
        half_turn.y = -half_turn.y;
    }
    Grain turned;
    turned.along = half_turn.x * g.along + half_turn.y * g.across;
    turned.across = half_turn.x * g.across - half_turn.y * g.along;
    return turned;
}
