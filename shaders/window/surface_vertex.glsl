// Vertex stage of a picture on a surface. Reads position and uv. u_toward moves the depth toward the viewer.

void main()
{
    gl_Position = u_matrix * vec4(position, 1.0);
    gl_Position.z += u_toward;
    v_uv = uv;
}
