/* A controller in plain C with libzmq: keeps the core zone's cooling setpoint constant for an episode in lockstep.
 *
 * Start a node and the gateway first, in two other terminals:
 *
 *     zenostat node --building office-small --weather USA_CO_Denver --begin 07-01 --end 07-07 --name office
 *     zenostat gateway zeromq --node office
 *
 * Then: cc -o controller zeromq_controller.c -lzmq && ./controller
 * Usage: controller [PUBLISH COMMAND [NODE [NAME]]]
 *
 * Of msgpack it knows what these messages have: maps, arrays, texts, bytes, small unsigned numbers.
 */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zmq.h>

#define SETPOINT "core_zn_cooling_setpoint"
#define MOST 65536

typedef unsigned char byte;

static char root[200], claim[200], command[200]; /* of keys */
static void *requests, *published;
static byte answer[8 * 1024 * 1024], sample[MOST], event[2 * MOST];

static void fail(const char *what) {
    fprintf(stderr, "%s\n", what);
    exit(1);
}

/* Decoding. */

static uint32_t big_endian(const byte *at, int bytes) {
    uint32_t value = 0;
    while (bytes--) value = value << 8 | *at++;
    return value;
}

/* Read the length of the map, array, string or bytes at *at (or a number), and advance past the header. */
static uint32_t head(const byte **at) {
    byte kind = *(*at)++;
    int bytes = 0;
    if (kind <= 0x7f) return kind;
    if (kind <= 0x9f) return kind & 0x0f;
    if (kind <= 0xbf) return kind & 0x1f;
    switch (kind) {
        case 0xc4: case 0xcc: case 0xd9: bytes = 1; break;
        case 0xc5: case 0xcd: case 0xda: case 0xdc: case 0xde: bytes = 2; break;
        case 0xc6: case 0xce: case 0xdb: case 0xdd: case 0xdf: bytes = 4; break;
        default: fail("msgpack of a kind that is not expected here");
    }
    *at += bytes;
    return big_endian(*at - bytes, bytes);
}

/* Return the position after the value at `at`, of any type. */
static const byte *behind(const byte *at) {
    byte kind = *at;
    uint32_t count;
    if (kind == 0xc0 || kind == 0xc2 || kind == 0xc3 || kind >= 0xe0) return at + 1;
    if (kind == 0xca || kind == 0xd2) return at + 5;
    if (kind == 0xcb || kind == 0xcf || kind == 0xd3) return at + 9;
    if (kind == 0xd0) return at + 2;
    if (kind == 0xd1) return at + 3;
    count = head(&at);
    if ((kind & 0xe0) == 0xa0 || (kind >= 0xc4 && kind <= 0xc6) || (kind >= 0xd9 && kind <= 0xdb)) return at + count;
    if ((kind & 0xf0) == 0x80 || kind >= 0xde) count *= 2;
    else if ((kind & 0xf0) != 0x90 && kind != 0xdc && kind != 0xdd) return at;
    while (count--) at = behind(at);
    return at;
}

static int is_text(const byte *at, const char *text) {
    uint32_t length = head(&at);
    return length == strlen(text) && !memcmp(at, text, length);
}

/* Return the value of a field of the map at `at`. */
static const byte *field(const byte *at, const char *name) {
    uint32_t count = head(&at);
    for (; count--; at = behind(behind(at)))
        if (is_text(at, name)) return behind(at);
    fail(name);
    return NULL;
}

/* Return the number of the only slot in a field that is a list. */
static uint32_t number(const byte *map, const char *name) {
    const byte *at = field(map, name);
    head(&at);
    return head(&at);
}

/* Encoding: all lengths are below 65536. */

static byte *put(byte *to, const void *from, size_t length) {
    memcpy(to, from, length);
    return to + length;
}

static byte *put_text(byte *to, const char *text) {
    *to++ = 0xd9;
    *to++ = (byte)strlen(text);
    return put(to, text, strlen(text));
}

static byte *put_number(byte *to, byte kind, uint32_t value) {
    *to++ = kind; /* 0xce: uint32, 0xc6: length of bytes */
    for (int shift = 24; shift >= 0; shift -= 8) *to++ = (byte)(value >> shift);
    return to;
}

static byte *put_bytes(byte *to, const void *from, size_t length) {
    return put(put_number(to, 0xc6, (uint32_t)length), from, length);
}

static byte *put_list(byte *to, const char *name, uint32_t value) {
    to = put_text(to, name);
    *to++ = 0x91;
    return put_number(to, 0xce, value);
}

/* Send a request and receive the reply; exit with the reason if it is an error. */
static void ask(const char *what, const void *payload, size_t length) {
    char topic[300], encoding[200];
    int size;
    snprintf(topic, sizeof topic, "%s/%s", root, what);
    zmq_send(requests, topic, strlen(topic), ZMQ_SNDMORE);
    zmq_send(requests, payload, length, 0);
    zmq_recv(requests, topic, sizeof topic, 0);
    size = zmq_recv(requests, encoding, sizeof encoding - 1, 0);
    if (size < 0 || size >= (int)sizeof encoding) fail("no answer");
    encoding[size] = 0;
    size = zmq_recv(requests, answer, sizeof answer, 0);
    if (size < 0 || size > (int)sizeof answer) fail("no answer that would fit");
    if (strstr(encoding, ".ErrorReply")) {
        const byte *at = field(answer, "message");
        uint32_t text = head(&at);
        fprintf(stderr, "%s: %.*s\n", what, (int)text, at);
        exit(1);
    }
}

/* Receive the next sample; exit with the reason if the episode has failed or the node has stopped. */
static void next_sample(void) {
    char topic[300], encoding[300];
    for (;;) {
        int size = zmq_recv(published, topic, sizeof topic - 1, 0);
        if (size < 0 || size >= (int)sizeof topic) fail("no message");
        topic[size] = 0;
        zmq_recv(published, encoding, sizeof encoding, 0);
        if (!strcmp(strrchr(topic, '/'), "/sample")) {
            if (zmq_recv(published, sample, sizeof sample, 0) > (int)sizeof sample) fail("a sample that is too large");
            return;
        }
        if (zmq_recv(published, event, sizeof event, 0) > (int)sizeof event) fail("an event that is too large");
        if (is_text(field(event, "kind"), "failed") || is_text(field(event, "kind"), "stopped")) {
            const byte *at = field(event, "text");
            uint32_t text = head(&at);
            fprintf(stderr, "%.*s\n", (int)text, at);
            exit(1);
        }
    }
}

static void subscribe(const char *what) {
    char topic[300];
    snprintf(topic, sizeof topic, "%s/%s", root, what);
    zmq_setsockopt(published, ZMQ_SUBSCRIBE, topic, strlen(topic));
}

int main(int argc, char **argv) {
    void *context = zmq_ctx_new();
    static byte request[MOST], operations[512];
    static double values[512];
    uint32_t actuators, setpoint, episode, step;
    const byte *at;
    byte *end;

    const char *me = argc > 4 ? argv[4] : "from-c";
    snprintf(root, sizeof root, "zenostat/v3/%s", argc > 3 ? argv[3] : "office");
    snprintf(claim, sizeof claim, "rpc/claim/%s", me);
    snprintf(command, sizeof command, "command/%s", me);
    requests = zmq_socket(context, ZMQ_REQ);
    published = zmq_socket(context, ZMQ_SUB);
    if (zmq_connect(published, argc > 2 ? argv[1] : "tcp://127.0.0.1:5556")) fail("PUBLISH is not an endpoint");
    if (zmq_connect(requests, argc > 2 ? argv[2] : "tcp://127.0.0.1:5557")) fail("COMMAND is not an endpoint");
    subscribe("sample");
    subscribe("event");

    ask("manifest", "", 0);
    at = field(answer, "actuators");
    actuators = head(&at);
    if (actuators > 512) fail("more actuators than this example has room for");
    for (setpoint = 0; setpoint < actuators; setpoint++, at = behind(at))
        if (is_text(field(at, "name"), SETPOINT)) break;
    if (setpoint == actuators) fail("the node has no actuator " SETPOINT);

    next_sample(); /* a new subscriber receives the latest sample */
    end = request;
    *end++ = 0x82;
    end = put_text(put_text(end, "controller"), me);
    end = put_text(end, "actuators");
    *end++ = 0x91;
    end = put_text(end, SETPOINT);
    ask(claim, request, (size_t)(end - request));

    while (!(number(sample, "flags") & 2)) { /* 2: the run period is over */
        episode = number(sample, "episode");
        step = number(sample, "step");
        operations[setpoint] = 1; /* 0: keep, 1: set, 2: relinquish */
        values[setpoint] = 26.0;
        end = request;
        *end++ = 0x84;
        end = put_list(put_list(end, "episode", episode), "step", step);
        end = put_bytes(put_text(end, "operations"), operations, actuators);
        end = put_bytes(put_text(end, "values"), values, actuators * sizeof(double)); /* little-endian machines */
        ask(command, request, (size_t)(end - request));
        while (number(sample, "episode") == episode && number(sample, "step") == step) next_sample();
    }
    at = field(sample, "time");
    head(&at);
    printf("%u timesteps to ", number(sample, "step"));
    episode = head(&at);
    printf("%.*s\n", (int)episode, at);
    zmq_close(published);
    zmq_close(requests);
    zmq_ctx_destroy(context);
    return 0;
}
