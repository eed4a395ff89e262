/* {{ title }} as a co-simulation FMU of FMI 2.0. The types are those of the standard. */
{% include "fmu/instance.c" %}

typedef void *component_t;
typedef unsigned int reference_t;

/* fmi2CallbackFunctions */
typedef struct {
    log_t logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} callbacks_t;

EXPORT const char *fmi2GetTypesPlatform(void);
EXPORT const char *fmi2GetVersion(void);
EXPORT int fmi2SetDebugLogging(component_t c, int on, size_t count, const char *const *categories);
EXPORT component_t fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
    const callbacks_t *functions, int visible, int logging);
EXPORT void fmi2FreeInstance(component_t c);
EXPORT int fmi2SetupExperiment(component_t c, int defined, double tolerance, double start, int stops, double stop);
EXPORT int fmi2EnterInitializationMode(component_t c);
EXPORT int fmi2ExitInitializationMode(component_t c);
EXPORT int fmi2Terminate(component_t c);
EXPORT int fmi2Reset(component_t c);
EXPORT int fmi2GetReal(component_t c, const reference_t *references, size_t count, double *values);
EXPORT int fmi2SetReal(component_t c, const reference_t *references, size_t count, const double *values);
EXPORT int fmi2GetFMUstate(component_t c, void **state);
EXPORT int fmi2SetFMUstate(component_t c, void *state);
EXPORT int fmi2FreeFMUstate(component_t c, void **state);
EXPORT int fmi2SerializedFMUstateSize(component_t c, void *state, size_t *size);
EXPORT int fmi2SerializeFMUstate(component_t c, void *state, char *bytes, size_t size);
EXPORT int fmi2DeSerializeFMUstate(component_t c, const char *bytes, size_t size, void **state);
EXPORT int fmi2DoStep(component_t c, double point, double size, int no_return);
EXPORT int fmi2CancelStep(component_t c);
{% for function, parameters in unsupported.items() %}
EXPORT int {{ function }}(component_t c, {{ parameters|map("join", "")|join(", ") }});
{% endfor %}

const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

const char *fmi2GetVersion(void)
{
    return "2.0";
}

int fmi2SetDebugLogging(component_t c, int on, size_t count, const char *const *categories)
{
    (void)c;
    (void)on;
    (void)count;
    (void)categories;
    return OK;
}

component_t fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
    const callbacks_t *functions, int visible, int logging)
{
    const listener_t listener = listener_of((functions != NULL) ? functions->logger : NULL,
        (functions != NULL) ? functions->environment : NULL, name);

    (void)resources;
    (void)visible;
    (void)logging; /* of debugging; errors are always told */
    if (type != 1) {
        tell(&listener, "fmi2Instantiate: type %d: this FMU is for co-simulation (1) only", type);
        return NULL;
    }
    return instantiate(guid, &listener);
}

void fmi2FreeInstance(component_t c)
{
    free(c);
}

int fmi2SetupExperiment(component_t c, int defined, double tolerance, double start, int stops, double stop)
{
    (void)defined;
    (void)tolerance;
    (void)stops;
    (void)stop;
    ((instance_t *)c)->state.time = start;
    return OK;
}

int fmi2EnterInitializationMode(component_t c)
{
    (void)c;
    return OK;
}

int fmi2ExitInitializationMode(component_t c)
{
    (void)c;
    return OK;
}

int fmi2Terminate(component_t c)
{
    (void)c;
    return OK;
}

int fmi2Reset(component_t c)
{
    begin((instance_t *)c);
    return OK;
}

int fmi2GetReal(component_t c, const reference_t *references, size_t count, double *values)
{
    return get_values((const instance_t *)c, "fmi2GetReal", references, count, values);
}

int fmi2SetReal(component_t c, const reference_t *references, size_t count, const double *values)
{
    return set_values((instance_t *)c, "fmi2SetReal", references, count, values);
}

int fmi2DoStep(component_t c, double point, double size, int no_return)
{
    (void)no_return;
    return do_step((instance_t *)c, point, size);
}

int fmi2GetFMUstate(component_t c, void **state)
{
    return get_state((const instance_t *)c, state);
}

int fmi2SetFMUstate(component_t c, void *state)
{
    return set_state((instance_t *)c, state);
}

int fmi2FreeFMUstate(component_t c, void **state)
{
    (void)c;
    return free_state(state);
}

int fmi2SerializedFMUstateSize(component_t c, void *state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(state_t);
    return OK;
}

int fmi2SerializeFMUstate(component_t c, void *state, char *bytes, size_t size)
{
    return serialize((const instance_t *)c, "fmi2SerializeFMUstate", state, bytes, size);
}

int fmi2DeSerializeFMUstate(component_t c, const char *bytes, size_t size, void **state)
{
    return deserialize((const instance_t *)c, "fmi2DeSerializeFMUstate", bytes, size, state);
}

int fmi2CancelStep(component_t c)
{
    return not_offered((const instance_t *)c, "fmi2CancelStep");
}

{% for function, parameters in unsupported.items() %}
int {{ function }}(component_t c, {{ parameters|map("join", "")|join(", ") }})
{
{% for kind, parameter in parameters %}
    (void){{ parameter }};
{% endfor %}
    return not_offered((const instance_t *)c, "{{ function }}");
}

{% endfor %}
