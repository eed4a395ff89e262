{% import "blocks/signals.c" as reader with context %}
{% macro state(b) %}
{{ reader.state(b) }}    real past[{{ b.past }}]; /* target velocity of earlier periods, oldest first [m/s] */
{% endmacro %}
{% macro code(b) %}
{{ reader.code(b) }}static void {{ b.name }}_reset({{ b.type }} *s)
{
{{ reader.reset(b) }}    fill(s->past, {{ b.past }}, {{ 0.0|real }});
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    real signals[8];
    real current;

    {{ b.name }}_read(s, y, signals);
    current = dot({{ b.name }}_taps, s->past, {{ b.past }}) + {{ b.name }}_taps[{{ b.past }}] * signals[6];
{% if b.preview %}
    {
        real before = signals[5];
        real velocity = {{ 0.0|real }};

        for (int i = 0; i < {{ b.preview }}; i++) { /* velocities to come, by trapezoids */
            for (int j = 0; j < {{ b.samples }}; j++) {
                const real coming = y[{{ b.first_preview }} + i * {{ b.samples }} + j] * {{ b.preview_scale|real }};

                velocity += coming + before;
                before = coming;
            }
            current += {{ b.name }}_taps[{{ b.past + 1 }} + i] * (signals[6] + {{ b.half_sample|real }} * velocity);
        }
    }
{% endif %}
    current += signals[5] * {{ b.acceleration_tap|real }} + dot({{ b.name }}_feedback, signals, 8);
    for (int i = 0; i < {{ b.past - 1 }}; i++) {
        s->past[i] = s->past[i + 1];
    }
    s->past[{{ b.past - 1 }}] = signals[6];
    *action = rounded(clip(number_or_zero(current / {{ b.limit|real }}), {{ -1.0|real }}, {{ 1.0|real }}));
}
{% endmacro %}
