{# What a table gives at the end of a period; part of other blocks. #}
{% macro code(b) %}
/* Signals of the table, then floors, then readings of the sensors without noise and offset; SI. */
static void {{ b.name }}_give(const {{ b.type }} *s, real acceleration, real shear, real *y)
{
    y[0] = s->state[1];
    y[1] = s->state[2];
    y[2] = acceleration;
    y[3] = s->state[0];
    y[4] = s->state[3];
    y[5] = shear;
    product({{ b.name }}_floors, {{ b.floors.shape[0] }}, {{ b.floors.shape[1] }}, &s->state[4], &y[6]);
{% if b.s %}
    for (int i = 0; i < {{ b.s }}; i++) { /* behind its low-pass, which is a state, or the signal itself */
        const real signal = ({{ b.name }}_from_state[i] != 0) ? s->state[{{ b.name }}_places[i]] : y[{{ b.name }}_places[i]];

        y[{{ 6 + b.floors.shape[0] }} + i] = ({{ b.name }}_rounds[i] != 0)
            ? real_rint(signal / {{ b.name }}_resolution[i]) * {{ b.name }}_resolution[i]
            : signal;
    }
{% endif %}
}

{% endmacro %}
