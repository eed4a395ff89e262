{% import "blocks/signals.c" as reader with context %}
{% macro state(b) %}
{{ reader.state(b) }}    real first; /* of the two low-passes of the disturbance [A] */
    real second;
    real past[{{ b.past }}]; /* commands before the present, newest first [A] */
    {{ b.inner.type }} inner;
{% endmacro %}
{% macro code(b) %}
{{ reader.code(b) }}static void {{ b.name }}_reset({{ b.type }} *s)
{
{{ reader.reset(b) }}    s->first = {{ 0.0|real }};
    s->second = {{ 0.0|real }};
    fill(s->past, {{ b.past }}, {{ 0.0|real }});
    {{ b.inner.name }}_reset(&s->inner);
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    real signals[8];
    real needed, unexplained, asked;

    {{ b.name }}_read(s, y, signals);
{% if b.last_action is not none %}
    /* What was given, which a supervisor may have changed. */
    s->past[0] = (real)((float){{ b.limit|real }} * (float)y[{{ b.last_action }}]);
{% endif %}
    needed = (signals[1] + {{ b.lag|real }} * signals[2]) / {{ b.velocity_gain|real }};
    unexplained = dot({{ b.name }}_arrivals, s->past, {{ b.past }}) - needed;
    s->first = number_or_zero(s->first + {{ b.follow|real }} * (unexplained - s->first));
    s->second = number_or_zero(s->second + {{ b.follow|real }} * (s->first - s->second));
    {{ b.inner.name }}_step(&s->inner, y, &asked);
    asked = clip(asked + s->second / {{ b.limit|real }}, {{ -1.0|real }}, {{ 1.0|real }});
    for (int i = {{ b.past - 1 }}; i > 0; i--) {
        s->past[i] = s->past[i - 1];
    }
    s->past[0] = number_or_zero({{ b.limit|real }} * asked);
    *action = rounded(asked);
}
{% endmacro %}
