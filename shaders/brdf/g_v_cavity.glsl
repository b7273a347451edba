// Masking and shadowing by V-shaped cavities. Torrance & Sparrow 1967, Theory for Off-Specular Reflection from
// Roughened Surfaces; Cook & Torrance 1982, A Reflectance Model for Computer Graphics, Eq. 9.

// G = min(1, 2 n·h n·v / v·h, 2 n·h n·l / v·h). v·h > 0 wherever light and view are above the horizon.
float G_VCavity(float NoL, float NoV, float NoH, float VoH)
{
    return min(1.0, 2.0 * NoH * min(NoL, NoV) / VoH);
}
