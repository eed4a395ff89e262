{% macro state(b) %}
    real action; /* last action [-] */
{% endmacro %}
{% macro code(b) %}
static void {{ b.name }}_reset({{ b.type }} *s)
{
    s->action = {{ 0.0|real }};
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    s->action = rounded(clip(dot({{ b.name }}_row, y, {{ b.row.size }}), {{ -1.0|real }}, {{ 1.0|real }}));
    *action = s->action;
}
{% endmacro %}
