// One tile of the web page as a strip of two triangles. u_quad: its left, bottom, right and top on the canvas, −1…1.

uniform vec4 u_quad;

void main()
{
    gl_Position = vec4(mix(u_quad.xy, u_quad.zw, vec2(gl_VertexID & 1, gl_VertexID >> 1)), 0.0, 1.0);
}
