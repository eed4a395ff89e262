{% import "blocks/table_outputs.c" as outputs with context %}
{% macro state(b) %}
    real state[{{ b.n }}]; /* load pressure, displacement, velocity, spool; specimen [SI] */
{% endmacro %}
{% macro code(b) %}
{{ outputs.code(b) }}static void {{ b.name }}_reset({{ b.type }} *s)
{
    fill(s->state, {{ b.n }}, {{ 0.0|real }});
}

static void {{ b.name }}_step({{ b.type }} *s, const real *action, real *y)
{
    real joined[{{ b.n + 1 }}];
    real moved[{{ b.n + 2 }}];

    copy(s->state, joined, {{ b.n }});
    joined[{{ b.n }}] = {{ b.limit|real }} * clip(action[0], {{ -1.0|real }}, {{ 1.0|real }});
    product({{ b.name }}_matrix, {{ b.n + 2 }}, {{ b.n + 1 }}, joined, moved);
    copy(moved, s->state, {{ b.n }});
    {{ b.name }}_give(s, moved[{{ b.n }}], moved[{{ b.n + 1 }}], y);
}
{% endmacro %}
