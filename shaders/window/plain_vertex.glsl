// Vertex stage of coloured triangles in a window. Reads position in pixels and color.

void main()
{
    gl_Position = u_matrix * vec4(position, 0.0, 1.0);
    v_color = color;
}
