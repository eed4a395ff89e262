{% import "blocks/table_outputs.c" as outputs with context %}
{% macro state(b) %}
    real state[{{ b.m }}]; /* load pressure, displacement, velocity, spool; specimen; further states [SI] */
{% if b.c %}
    real commands[{{ b.c }}]; /* under way, oldest first [A] */
{% endif %}
{% endmacro %}
{% macro code(b) %}
{{ outputs.code(b) }}/* What the linear table leaves out: flow [m of spool], force [N], spool rate [m/s]{% if b.yields %}, slips [m/s]{% endif %}. */
static void {{ b.name }}_parts(const real *x, real current, real *g)
{
    (void)x;
    (void)current;
    g[0] = {{ 0.0|real }};
    g[1] = {{ 0.0|real }};
    g[2] = {{ 0.0|real }};
{% if b.flow_active %}
    g[0] = valve_opening(x[3], x[0]) - x[3];
{% endif %}
{% if b.friction.active %}
    {
        real level = {{ b.coulomb|real }};

{% if b.friction.static is not none %}
        level += {{ (b.friction.static - b.friction.coulomb)|real }} * real_exp(-(x[2] / {{ b.friction.stribeck_velocity|real }}) * (x[2] / {{ b.friction.stribeck_velocity|real }}));
{% endif %}
        g[1] = -(level * real_tanh(x[2] / {{ b.friction.smoothing_velocity|real }}) + {{ b.friction.viscous|real }} * x[2]);
    }
{% endif %}
{% if b.stops.active %}
    {
        const real side = (x[1] > {{ 0.0|real }}) ? {{ 1.0|real }} : {{ -1.0|real }};
        const real depth = larger(absolute(x[1]) - {{ b.stops.gap|real }}, {{ 0.0|real }});
        const real damper = {{ b.stops.damping|real }} * side * x[2] * clip(depth / {{ 1e-3|real }}, {{ 0.0|real }}, {{ 1.0|real }});

        g[1] -= side * larger({{ b.stops.stiffness|real }} * depth + damper, {{ 0.0|real }});
    }
{% endif %}
{% if b.rate_limit is not none %}
    {
        const real unlimited = {% if b.second_order %}x[{{ b.m - 1 }}]{% else %}{{ b.rate_on_spool|real }} * x[3] + {{ b.rate_on_current|real }} * current{% endif %};

        g[2] = clip(unlimited, {{ -b.rate_limit|real }}, {{ b.rate_limit|real }}) - unlimited;
    }
{% else %}
{% endif %}
{% if b.yields %}
    for (int i = 0; i < {{ b.stories }}; i++) { /* Bouc and Wen's law */
        const real below = (i > 0) ? x[3 + i] : {{ 0.0|real }};
        const real below_rate = (i > 0) ? x[{{ 3 + b.stories }} + i] : {{ 0.0|real }};
        const real drift = x[4 + i] - below;
        const real rate = x[{{ 4 + b.stories }} + i] - below_rate;
        const real hysteretic = (drift - x[{{ 4 + 2 * b.stories }} + i]) / {{ b.yielding.yield_drift|real }};
        const real loading = (rate * hysteretic > {{ 0.0|real }}) ? {{ 1.0|real }} : {{ 0.0|real }};

        g[3 + i] = rate * loading * real_pow(clip(absolute(hysteretic), {{ 0.0|real }}, {{ 1.0|real }}), {{ b.yielding.exponent|real }});
    }
{% endif %}
}

static void {{ b.name }}_reset({{ b.type }} *s)
{
    fill(s->state, {{ b.m }}, {{ 0.0|real }});
{% if b.c %}
    fill(s->commands, {{ b.c }}, {{ 0.0|real }});
{% endif %}
}

static void {{ b.name }}_step({{ b.type }} *s, const real *action, real *y)
{
    real queue[{{ b.c + 1 }}], currents[{{ b.k }}], g[{{ b.q }}], change[{{ b.q }}];
    real joined[{{ b.m + 1 + b.q }}], moved[{{ b.m }}], ends[2];

{% if b.c %}
    copy(s->commands, queue, {{ b.c }});
{% endif %}
    queue[{{ b.c }}] = {{ b.limit|real }} * clip(action[0], {{ -1.0|real }}, {{ 1.0|real }});
    product({{ b.name }}_arrival, {{ b.k }}, {{ b.c + 1 }}, queue, currents);
    {{ b.name }}_parts(s->state, currents[0], g);
    for (int j = 0; j < {{ b.k }}; j++) {
        /* One physics step by ETD2RK: parts held over the step, then the effect of their change. */
        copy(s->state, joined, {{ b.m }});
        joined[{{ b.m }}] = currents[j];
        copy(g, &joined[{{ b.m + 1 }}], {{ b.q }});
        product({{ b.name }}_advance, {{ b.m }}, {{ b.m + 1 + b.q }}, joined, moved);
        {{ b.name }}_parts(moved, currents[j], change);
        for (int i = 0; i < {{ b.q }}; i++) {
            change[i] -= g[i];
        }
        add_product({{ b.name }}_slope, {{ b.m }}, {{ b.q }}, change, moved);
{% if b.spool_limit is not none %}
        moved[3] = clip(moved[3], {{ -b.spool_limit|real }}, {{ b.spool_limit|real }}); /* it rests on its stop */
{% endif %}
        copy(moved, s->state, {{ b.m }});
        {{ b.name }}_parts(s->state, currents[(j + 1 < {{ b.k }}) ? j + 1 : j], g);
    }
{% if b.c %}
    copy(&queue[1], s->commands, {{ b.c }});
{% endif %}
    product({{ b.name }}_C, 2, {{ b.m }}, s->state, ends);
    add_product({{ b.name }}_D, 2, {{ b.q }}, g, ends);
    {{ b.name }}_give(s, ends[0], ends[1], y);
}
{% endmacro %}
