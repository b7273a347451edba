// Visibility for anisotropic GGX: masking and shadowing over 4 (n·l) (n·v). Height-correlated: Heitz 2014,
// Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs, Eq. 86 and 99. Cycles uses this form.

// V = G / (4 n·l n·v), G = 1 / (1 + Λ(l) + Λ(v)), Λ(d) = (√(1 + ((αx x·d)² + (αy y·d)²) / (n·d)²) − 1) / 2. Multiplied
// out as in v_smith_ggx.glsl. l and v: (x·d, y·d, n·d) of light and view.
float V_SmithGGXAnisotropic(vec3 l, vec3 v, float alpha_x, float alpha_y)
{
    vec3 widths = vec3(alpha_x, alpha_y, 1.0);
    return 0.5 / (v.z * length(widths * l) + l.z * length(widths * v));
}
