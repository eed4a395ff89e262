/* {{ title }}.
 *
 * One decision each {{ period }} s: {{ name }}_step reads {{ inputs|length }} numbers and gives {{ outputs|length }}.
 * No allocation, no recursion, no library but math.h; every loop has a bound known when it is compiled.
 * A program keeps its memory in a {{ name }}_t of the caller's. Programs with memories of their own may
 * run at the same time.
 *
{% for key, text in provenance.items() %}
 * {{ key }}: {{ text }}
{% endfor %}
 *
 * Inputs (as {{ name }}_step_si takes them; {{ name }}_step takes each divided by its scale):
{% for channel in inputs %}
 *   {{ "%3d"|format(loop.index0) }}  {{ channel.name }} [{{ channel.unit }}], scale {{ "%.9g"|format(channel.scale) }}
{% endfor %}
 * Outputs:
{% for channel in outputs %}
 *   {{ "%3d"|format(loop.index0) }}  {{ channel.name }} [{{ channel.unit }}], scale {{ "%.9g"|format(channel.scale) }}
{% endfor %}
 */
#ifndef {{ NAME }}_H
#define {{ NAME }}_H

#ifdef __cplusplus
extern "C" {
#endif

#define {{ NAME }}_INPUTS {{ inputs|length }}
#define {{ NAME }}_OUTPUTS {{ outputs|length }}
#define {{ NAME }}_PERIOD {{ period }} /* [s] */

/* What {{ name }}_step returns. After a refusal the memory is as it was before. */
#define {{ NAME }}_OK 0
#define {{ NAME }}_REFUSED 1 /* an input is NaN or infinite: the outputs are 0 */
#define {{ NAME }}_FAILED 2  /* a result was no finite number: it is given as 0 */

typedef {{ c_type }} {{ name }}_real;

{% for block in blocks %}
/* {{ block.summary }} */
typedef struct {
{{ block.state }}} {{ block.type }};

{% endfor %}
typedef struct {
    {{ blocks[-1].type }} {{ blocks[-1].name }};
} {{ name }}_t;

extern const char *const {{ name }}_input_names[{{ NAME }}_INPUTS];
extern const char *const {{ name }}_input_units[{{ NAME }}_INPUTS];
extern const {{ name }}_real {{ name }}_input_scales[{{ NAME }}_INPUTS];
extern const char *const {{ name }}_output_names[{{ NAME }}_OUTPUTS];
extern const char *const {{ name }}_output_units[{{ NAME }}_OUTPUTS];
extern const {{ name }}_real {{ name }}_output_scales[{{ NAME }}_OUTPUTS];
extern const char *const {{ name }}_provenance[{{ provenance|length }}];

/* Size of a memory in bytes. */
unsigned long {{ name }}_size(void);

/* Begin with nothing remembered{% if blocks[-1].kind == "supervisor" %}, and counts of interventions at zero{% endif %}. */
void {{ name }}_init({{ name }}_t *memory);

/* Begin a new test{% if blocks[-1].kind == "supervisor" %}; counts of interventions go on{% endif %}. */
void {{ name }}_reset({{ name }}_t *memory);

/* One period, inputs and outputs over their scales. */
int {{ name }}_step({{ name }}_t *memory, const {{ name }}_real *inputs, {{ name }}_real *outputs);

/* The same in SI. */
int {{ name }}_step_si({{ name }}_t *memory, const {{ name }}_real *inputs, {{ name }}_real *outputs);

#ifdef __cplusplus
}
#endif

#endif
