// Vertex stage of lines and points of any width, each a rectangle that faces the viewer: only OpenGL has wide lines.
// Reads begin and end of a line (equal for a point), their colours, and the corner of the rectangle (x: 0 at the begin,
// 1 at the end; y: −1 or 1 across). u_size: the window in pixels. All other lengths are in pixels.

void main()
{
    vec4 a = u_matrix * vec4(begin, 1.0);
    vec4 b = u_matrix * vec4(end, 1.0);
    // Clips at the near plane. Behind the eye a line would be reversed.
    float near_a = a.z + a.w;
    float near_b = b.z + b.w;
    vec4 from = near_a < 0.0 && near_b > 0.0 ? mix(a, b, near_a / (near_a - near_b)) : a;
    vec4 to = near_b < 0.0 && near_a > 0.0 ? mix(b, a, near_b / (near_b - near_a)) : b;
    bool hidden = max(near_a, near_b) < 0.0 || from.w <= 0.0 || to.w <= 0.0;
    v_begin = vec2(0.0);
    v_end = vec2(0.0);
    v_place = vec2(0.0);
    v_begin_color = begin_color;
    v_end_color = end_color;
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    if (hidden) {
        return;
    }
    v_begin = (0.5 * from.xy / from.w + 0.5) * u_size;
    v_end = (0.5 * to.xy / to.w + 0.5) * u_size;
    vec2 along = v_end - v_begin;
    float length_px = length(along);
    along = length_px > 0.0 ? along / length_px : vec2(1.0, 0.0);
    // Half the width plus one pixel for the antialiased edge.
    float reach = 0.5 * u_width + 1.0;
    vec2 middle = corner.x < 0.5 ? v_begin - reach * along : v_end + reach * along;
    v_place = middle + corner.y * reach * vec2(-along.y, along.x);
    vec4 place = corner.x < 0.5 ? from : to;
    gl_Position = vec4(2.0 * v_place / u_size - 1.0, (place.z + u_toward) / place.w, 1.0);
}
