// Rasterises a mesh. Reads four textures, with one texel per corner of a triangle:
//   u_place     x·w, y·w in pixels from the picture's centre, w
//   u_position  xyz, u      u_normal  xyz, v      u_tangent  xyz, sign
// Writes position and coverage, unit normal, unit tangent and sign, uv, unit face normal and number (from 1).
//
// The barycentric weights are computed for the exact centre of the pixel. The hardware would first snap the corners to
// a grid of 1/256 pixel.

vec4 corner(sampler2D corners, int number)
{
    int index = 3 * v_triangle + number;
    int columns = textureSize(corners, 0).x;
    return texelFetch(corners, ivec2(index % columns, index / columns), 0);
}

// Returns the homogeneous coordinates of a corner relative to the pixel's centre.
vec2 offset_from_pixel(int number)
{
    vec3 place = corner(u_place, number).xyz;
    return place.xy - (gl_FragCoord.xy - 0.5 * u_size) * place.z;
}

float cross2(vec2 a, vec2 b)
{
    return a.x * b.y - a.y * b.x;
}

// Olano, Greer 1997, Triangle Scan Conversion using 2D Homogeneous Coordinates: valid under perspective and for corners
// behind the camera. A centre that the hardware rounds into the triangle may lie outside by 1/256 pixel. Then the
// weights extrapolate in the triangle's plane, limited to −1, because on slivers the extrapolation is unbounded.
vec3 corner_weights()
{
    vec2 a = offset_from_pixel(0), b = offset_from_pixel(1), c = offset_from_pixel(2);
    vec3 weights = vec3(cross2(b, c), cross2(c, a), cross2(a, b));
    float total = weights.x + weights.y + weights.z;
    if (total == 0.0) {
        return vec3(1.0 / 3.0);
    }
    weights = max(weights / total, -1.0);
    return weights / (weights.x + weights.y + weights.z);
}

vec3 unit_or(vec3 v, vec3 otherwise)
{
    float squared = dot(v, v);
    return squared > 0.0 ? v * inversesqrt(squared) : otherwise;
}

void main()
{
    vec3 weights = corner_weights();
    vec4 a = corner(u_position, 0), b = corner(u_position, 1), c = corner(u_position, 2);
    vec4 position = mat3x4(a, b, c) * weights;
    vec4 normal = mat3x4(corner(u_normal, 0), corner(u_normal, 1), corner(u_normal, 2)) * weights;
    vec4 tangent = mat3x4(corner(u_tangent, 0), corner(u_tangent, 1), corner(u_tangent, 2)) * weights;

    vec3 e1 = b.xyz - a.xyz, e2 = c.xyz - a.xyz;
    vec3 normal_of_face = cross(e1, e2);
    // Edges within 1e-5 of parallel: in float32 the direction of their cross product is rounding.
    if (dot(normal_of_face, normal_of_face) <= 1e-10 * dot(e1, e1) * dot(e2, e2)) {
        normal_of_face = vec3(0.0);
    }
    vec3 n = unit_or(normal.xyz, unit_or(normal_of_face, vec3(0.0, 0.0, 1.0)));
    // The normals determine the outer side, not the winding, which is reversed on mirrored objects.
    vec3 face = unit_or(dot(normal_of_face, n) < 0.0 ? -normal_of_face : normal_of_face, n);
    vec3 helper_axis = abs(n.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0);
    vec3 t = unit_or(tangent.xyz - n * dot(n, tangent.xyz), normalize(cross(helper_axis, n)));

    out_position = vec4(position.xyz, 1.0);
    out_normal = vec4(n, 0.0);
    out_tangent = vec4(t, tangent.w < 0.0 ? -1.0 : 1.0);
    out_uv = vec4(position.w, normal.w, 0.0, 0.0);
    out_face = vec4(face, float(v_triangle + 1));
}
