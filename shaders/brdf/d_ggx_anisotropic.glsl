// Distribution of microfacet normals, wider in one direction than across it. Burley 2012, Physically-Based Shading at
// Disney, Eq. 13. With equal widths it is that of Walter et al. 2007 (d_ggx.glsl).

// D = 1 / (π αx αy ((x·h)² / αx² + (y·h)² / αy² + (n·h)²)²), with x, y, n orthonormal; alpha_x and alpha_y in (0, 1].
// XoH and YoH: see xy_of_half below.
float D_GGXAnisotropic(float XoH, float YoH, float NoH, float alpha_x, float alpha_y)
{
    float x = XoH / alpha_x;
    float y = YoH / alpha_y;
    float k = x * x + y * y + NoH * NoH;
    return 1.0 / (3.14159265358979 * alpha_x * alpha_y * k * k);
}

// Returns x·h and y·h of the half vector h of l and v. They are computed from n × h, which is precise near the peak of
// the highlight. Rounding errors of x and y along n then have no effect.
vec2 xy_of_half(vec3 n, vec3 x, vec3 y, vec3 l, vec3 v)
{
    vec3 sum = l + v;
    vec3 n_cross_h = cross(n, sum) * inversesqrt(dot(sum, sum));
    return vec2(dot(n_cross_h, y), -dot(n_cross_h, x));
}
