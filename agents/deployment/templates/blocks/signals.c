{# The eight signals of a laboratory's controller, taken from an observation; part of other blocks. #}
{% macro state(b) %}
    real target_displacement; /* integral of the target's velocity [m] */
    real target_velocity; /* its last value [m/s] */
{% endmacro %}
{% macro reset(b) %}
    s->target_displacement = {{ 0.0|real }};
    s->target_velocity = {{ 0.0|real }};
{% endmacro %}
{% macro code(b) %}
/* Table displacement, velocity, acceleration, load pressure, spool position; the target's
 * acceleration, velocity, displacement; SI. */
static void {{ b.name }}_read({{ b.type }} *s, const real *y, real signals[8])
{
    product({{ b.name }}_signals, 8, {{ b.signals.shape[1] }}, y, signals);
{% if b.integrates %}
    s->target_displacement += {{ b.half_period|real }} * (s->target_velocity + signals[6]);
    s->target_velocity = signals[6];
    signals[7] = s->target_displacement;
{% else %}
    s->target_displacement = signals[7];
    s->target_velocity = signals[6];
{% endif %}
}

{% endmacro %}
