{% macro state(b) %}
    real action; /* last action [-] */
{% endmacro %}
{% macro code(b) %}
{% if b.friction %}
/* Friction on the table at a velocity [m/s], [N]. */
static real {{ b.name }}_friction(real velocity)
{
    real level = {{ b.coulomb|real }};

{% if b.static is not none %}
    level += {{ (b.static - b.coulomb)|real }} * real_exp(-(velocity / {{ b.stribeck_velocity|real }}) * (velocity / {{ b.stribeck_velocity|real }}));
{% endif %}
    return -(level * real_tanh(velocity / {{ b.smoothing_velocity|real }}) + {{ b.viscous|real }} * velocity);
}

{% endif %}
static void {{ b.name }}_reset({{ b.type }} *s)
{
    s->action = {{ 0.0|real }};
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    real wanted = dot({{ b.name }}_row, y, {{ b.row.size }});
{% if b.friction %}
    real current = {{ 0.0|real }};

    for (int t = 0; t < {{ b.times }}; t++) { /* friction expected over the horizon */
        const real velocity = dot(&{{ b.name }}_velocity[t * {{ b.order }}], y, {{ b.order }});
        real force = {{ 0.0|real }};

        for (int i = 0; i < {{ b.nodes.size }}; i++) {
            force += {{ b.name }}_weights[i] * {{ b.name }}_friction(velocity + {{ b.name }}_spread[t] * {{ b.name }}_nodes[i]);
        }
        current += force * {{ b.name }}_force_row[t];
    }
    wanted += current / {{ b.limit|real }};
{% endif %}
{% if b.orifice %}
    {
        real withheld = {{ 0.0|real }};

        for (int t = 0; t < {{ b.times }}; t++) { /* flow that the valve will withhold */
            const real pressure = dot(&{{ b.name }}_pressure[t * {{ b.order }}], y, {{ b.order }});
            const real spool = dot(&{{ b.name }}_spool[t * {{ b.order }}], y, {{ b.order }});

            withheld += (valve_opening(spool, pressure) - spool) * {{ b.name }}_flow_row[t];
        }
        wanted += withheld / {{ b.limit|real }};
    }
{% endif %}
    s->action = rounded(clip(wanted, {{ -1.0|real }}, {{ 1.0|real }}));
    *action = s->action;
}
{% endmacro %}
