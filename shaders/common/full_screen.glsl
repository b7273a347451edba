// Vertex stage of a fragment pass: one triangle over the viewport. The viewport is set to the rows to be drawn.

void main()
{
    gl_Position = vec4(position, 0.0, 1.0);
}
