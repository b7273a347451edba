// Loops of 2×2 texels, and how their circulation depends on the slopes. The texel with the least x and y begins a loop; the
// slope along an edge is the mean of its ends'.

// The factors on the slopes of the texel at an offset, (0, 0) to (1, 1), from the beginning of the loop.
vec2 loop_sign(ivec2 by)
{
    return by == ivec2(0, 0) ? vec2(0.5, -0.5) : by == ivec2(1, 0) ? vec2(0.5, 0.5)
         : by == ivec2(1, 1) ? vec2(-0.5, 0.5) : vec2(-0.5, -0.5);
}

// Cᵀ y at a texel: the sum over its four loops, which begin here, left, left below and below.
vec2 pull_of(float here, float left, float beyond, float below)
{
    return 0.5 * ((here - beyond) * vec2(1.0, -1.0) + (left - below) * vec2(1.0, 1.0));
}

// covariance: (xx, xy, yy). Returns it times v.
vec2 times(vec3 covariance, vec2 v)
{
    return vec2(dot(covariance.xy, v), dot(covariance.yz, v));
}
