{% macro state(b) %}
    real integral; /* of the displacement error [m s] */
{% endmacro %}
{% macro code(b) %}
static void {{ b.name }}_reset({{ b.type }} *s)
{
    s->integral = {{ 0.0|real }};
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    const real wanted = dot({{ b.name }}_row, y, {{ b.row.size }}) + {{ b.gain|real }} * s->integral;
    const real given = clip(wanted, {{ -1.0|real }}, {{ 1.0|real }});
    const real step = dot({{ b.name }}_error, y, {{ b.error.size }});
    const int winding = (wanted > given || wanted < given) && {{ b.gain|real }} * step * wanted > {{ 0.0|real }};

    if (!winding) { /* saturated: the integral does not move further that way */
        s->integral += step;
    }
    *action = rounded(given);
}
{% endmacro %}
