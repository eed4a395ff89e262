/* Spool position [m] that would let the same flow through a linear valve, at a load pressure [Pa]. */
static real valve_opening(real spool, real pressure)
{
    real opening = spool;
{% if spool_limit is not none %}

    opening = clip(opening, {{ -spool_limit|real }}, {{ spool_limit|real }});
{% endif %}
{% if dead_band > 0 %}
    {
        const real past = larger(absolute(opening) - {{ dead_band|real }}, {{ 0.0|real }});

        opening = (opening < {{ 0.0|real }}) ? -past : past;
    }
{% endif %}
{% if supply_pressure is not none %}
    {
        const real sign = (opening > {{ 0.0|real }}) ? {{ 1.0|real }} : ((opening < {{ 0.0|real }}) ? {{ -1.0|real }} : {{ 0.0|real }});
        const real shortage = {{ missing|real }} + {{ supply_sag|real }} * absolute(opening); /* of the supply [Pa] */

        opening *= real_sqrt(larger({{ 1.0|real }} - (sign * pressure + shortage) / {{ rated|real }}, {{ 1e-6|real }}));
    }
{% endif %}
    return opening;
}
