// Diffuse reflection. Lambert 1760, Photometria.

// Returns π f_r cos θ for a white surface: radiance under a light of intensity 1 (irradiance π at normal incidence).
float Fd_Lambert(float NoL)
{
    return max(NoL, 0.0);
}
