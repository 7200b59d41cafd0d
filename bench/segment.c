/* One RS-485 segment for benchmarks: a pty for each master, simulated slaves, character times of the wire.

   segment BAUD T_ID1 T_ID2 MIN_TSDR T_SL SLICE STATIONS [ADDRESS:IDENT:CONFIG:INPUTS:OUTPUTS ...]

   T_* and MIN_TSDR in bit times, SLICE in octets: octets are handed over in such portions, the last one when the last
   bit is on the wire. Of slaves IDENT and CONFIG are hexadecimal octets, INPUTS and OUTPUTS numbers of octets.

   A telegram begins when it is read from its master, no sooner than the idle time of the rules behind that master's own
   last one (what came sooner is counted as held); an octet lasts 11 bits. Every other master gets every octet, the
   sender does not. A telegram that begins while another sender's is on the wire is a collision: the rest of both is
   inverted, and no slave answers. Slaves answer MIN_TSDR after a request.

   Output: one JSON line with the ports. Orders on standard input, one a line: "begin" forgets what was counted, "end"
   answers with one JSON line. The end of the input ends it. */

#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { STATIONS = 8, SLAVES = 32, OCTETS = 255, ON_WIRE = 32, KEPT = 65536, BUFFER = 4096 };
enum { SD1 = 0x10, SD2 = 0x68, SD3 = 0xA2, SD4 = 0xDC, SC = 0xE5, ED = 0x16, BROADCAST = 127 };
enum { DIAG = 60, SET_PRM = 61, CHK_CFG = 62 };

typedef int64_t ns_t;

static const ns_t NEVER = INT64_MAX;
/* So long after the last octets it looks for more without sleeping, and so long before the next ones are due. */
static const ns_t LOOK = 1000000, SPIN = 150000;

struct telegram {
    uint8_t octets[OCTETS + 6];
    int count;
};

struct transmission {
    struct telegram telegram;
    int sender; /* number of a station, or -1: a slave */
    ns_t begin, end;
    int handed; /* octets that the others have */
    int spoilt_from; /* octets from here on are inverted */
};

struct station {
    int fd, far;
    uint8_t buffer[BUFFER];
    int filled;
    ns_t free_at; /* its next telegram begins no sooner */
    struct telegram last; /* what it sent last, if nobody has sent since */
};

struct slave {
    int address, inputs, outputs, config_count;
    uint8_t ident[2], config[OCTETS];
    int parametrized, configured, owner;
    int kept_sa, kept_fcb;
    struct telegram kept;
};

struct counters {
    long telegrams, exchanges, tokens, token_repeats, claims, repeats, collisions, held, dropped, late_tokens;
    ns_t begin, ruled; /* ruled: the time of everything by the rules */
    int rotations, answers;
    uint32_t rotation[KEPT], answer[KEPT];
};

static double bit_ns;
static long t_id1, t_id2, min_tsdr, t_sl, slice;
static struct station stations[STATIONS];
static struct slave slaves[SLAVES];
static struct transmission on_wire[ON_WIRE];
static int station_count, slave_count, wire_count;
static struct counters counted;
static ns_t token_at; /* when the last token ended that nobody has answered yet, or 0 */
static int token_from;
static ns_t round_at; /* when the first master got the token, or 0 */
static int first_master = -1; /* address of the first master that got a token */

static ns_t now_ns(void)
{
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return (ns_t)at.tv_sec * 1000000000 + at.tv_nsec;
}

static ns_t bits(long count) { return (ns_t)(count * bit_ns + 0.5); }

static void fail(const char *what)
{
    fprintf(stderr, "segment: %s: %s\n", what, strerror(errno));
    exit(1);
}

/* --- telegrams --- */

/* Octets of the telegram at the front, 0: more are needed, -1: none begins here. */
static int length(const uint8_t *octets, int count)
{
    int size;
    switch (octets[0]) {
    case SC: return 1;
    case SD4: size = 3; break;
    case SD1: size = 6; break;
    case SD3: size = 14; break;
    case SD2:
        if (count < 4) return 0;
        if (octets[1] != octets[2] || octets[3] != SD2 || octets[1] < 3) return -1;
        size = octets[1] + 6;
        break;
    default: return -1;
    }
    return count < size ? 0 : size;
}

static uint8_t sum(const uint8_t *octets, int count)
{
    uint8_t total = 0;
    while (count--) total += *octets++;
    return total;
}

/* DA and what follows it up to the data, NULL where there is none or it is damaged. */
static const uint8_t *body_of(const struct telegram *telegram, int *count)
{
    const uint8_t *octets = telegram->octets;
    int head = octets[0] == SD2 ? 4 : 1;
    if (octets[0] != SD1 && octets[0] != SD2 && octets[0] != SD3) return NULL;
    *count = telegram->count - head - 2;
    if (sum(octets + head, *count) != octets[head + *count] || octets[head + *count + 1] != ED) return NULL;
    return octets + head;
}

static void short_answer(struct telegram *out, int to, int from, int fc)
{
    const uint8_t octets[] = {SD1, to, from, fc, (uint8_t)(to + from + fc), ED};
    memcpy(out->octets, octets, out->count = sizeof octets);
}

static void long_answer(struct telegram *out, int to, int from, int fc, const uint8_t *data, int count)
{
    uint8_t *octets = out->octets;
    octets[0] = octets[3] = SD2;
    octets[1] = octets[2] = 3 + count;
    octets[4] = to;
    octets[5] = from;
    octets[6] = fc;
    memcpy(octets + 7, data, count);
    octets[7 + count] = sum(octets + 4, 3 + count);
    octets[8 + count] = ED;
    out->count = 9 + count;
}

/* --- slaves --- */

static void serve(struct slave *slave, int sa, int sap, int master_sap, const uint8_t *data, int count, struct telegram *out)
{
    uint8_t answer[OCTETS] = {0};
    out->octets[0] = SC;
    out->count = 1;
    if (sap == DIAG) {
        const int ready = slave->parametrized && slave->configured;
        const uint8_t octets[] = {
            master_sap, DIAG, ready ? 0 : 2, 4 | !slave->parametrized, 0, slave->owner, slave->ident[0], slave->ident[1]};
        long_answer(out, sa | 0x80, slave->address | 0x80, 0x08, octets, sizeof octets);
    } else if (sap == SET_PRM) {
        slave->configured = 0;
        slave->parametrized = count >= 7 && (data[0] & 0xC0) == 0x80 && !memcmp(data + 4, slave->ident, 2);
        slave->owner = slave->parametrized ? sa : 255;
    } else if (sap == CHK_CFG) {
        slave->configured = slave->parametrized && sa == slave->owner && count == slave->config_count
            && !memcmp(data, slave->config, count);
    } else if (sap < 0 && slave->parametrized && slave->configured && sa == slave->owner
               && (count == 0 || count == slave->outputs)) {
        counted.exchanges++;
        if (slave->inputs) {
            memset(answer, slave->address, slave->inputs);
            long_answer(out, sa, slave->address, 0x08, answer, slave->inputs);
        }
    } else {
        short_answer(out, sa, slave->address, 0x03); /* no such service, or not now */
    }
}

static struct slave *slave_at(int address)
{
    for (int n = 0; n < slave_count; n++)
        if (slaves[n].address == address) return &slaves[n];
    return NULL;
}

/* The answer to a request; no octets where there is none. */
static void answer_to(const struct telegram *request, struct telegram *out)
{
    int count, sap = -1, master_sap = -1, fcb;
    const uint8_t *body = body_of(request, &count), *data;
    out->count = 0;
    if (!body || !(body[2] & 0x40)) return;
    struct slave *slave = slave_at(body[0] & 0x7F);
    if (!slave) return;
    const int sa = body[1] & 0x7F, fc = body[2], function = fc & 0x0F;
    data = body + 3;
    count -= 3;
    if (body[0] & 0x80) sap = *data++, count--;
    if (body[1] & 0x80) master_sap = *data++, count--;
    if (count < 0) return;
    if (function == 0x09) {
        short_answer(out, sa, slave->address, 0x00);
        return;
    }
    if (function != 0x03 && function != 0x05 && function != 0x0C && function != 0x0D) return;
    fcb = (fc & 0x20) != 0;
    if (fc & 0x10 && sa == slave->kept_sa && fcb == slave->kept_fcb) {
        *out = slave->kept;
        return;
    }
    serve(slave, sa, sap, master_sap, data, count, out);
    slave->kept_sa = sa;
    slave->kept_fcb = fcb;
    slave->kept = *out;
}

/* --- the wire --- */

static struct transmission *send_at(const struct telegram *telegram, int sender, ns_t begin)
{
    if (wire_count == ON_WIRE) {
        counted.dropped++;
        return NULL;
    }
    struct transmission *made = &on_wire[wire_count++];
    *made = (struct transmission){*telegram, sender, begin, begin + bits(11 * telegram->count), 0, OCTETS + 6};
    for (struct transmission *other = on_wire; other < made; other++)
        if (other->sender != sender && other->begin < made->end && begin < other->end) {
            const int sent = begin > other->begin ? (int)((begin - other->begin) / bits(11)) : 0;
            counted.collisions++;
            made->spoilt_from = 0;
            if (sent < other->spoilt_from) other->spoilt_from = sent;
        }
    return made;
}

static void keep(uint32_t *values, int *count, ns_t value)
{
    values[(*count)++ % KEPT] = value > UINT32_MAX ? UINT32_MAX : (uint32_t)value;
}

/* Tokens of a ring: who has it, for how long nobody answered, when it comes round. */
static void count_token(const struct transmission *sent, int repeated)
{
    const int to = sent->telegram.octets[1], from = sent->telegram.octets[2];
    counted.tokens++;
    if (repeated) counted.token_repeats++;
    if (to == from) counted.claims++;
    if (first_master < 0) first_master = to;
    if (to == first_master && to != from && !repeated) {
        if (round_at) keep(counted.rotation, &counted.rotations, sent->end - round_at);
        round_at = sent->end;
    }
    token_at = sent->end;
    token_from = sent->sender;
}

/* The idle time of the rules behind a telegram, in bit times: a request that nobody answers takes the slot time. */
static long idle_after(const struct telegram *telegram)
{
    int count;
    const uint8_t *body = body_of(telegram, &count);
    if (!body || !(body[2] & 0x40)) return t_id1;
    const int to = body[0] & 0x7F, function = body[2] & 0x0F;
    if (to == BROADCAST || function == 0x04 || function == 0x06) return t_id2;
    return slave_at(to) ? t_id1 : t_sl;
}

static void transmit(int number, const struct telegram *telegram, ns_t now)
{
    struct station *station = &stations[number];
    const int repeated = telegram->count == station->last.count
        && !memcmp(telegram->octets, station->last.octets, telegram->count);
    const ns_t begin = now > station->free_at ? now : station->free_at;
    const int is_token = telegram->octets[0] == SD4;
    const ns_t idle = bits(idle_after(telegram));
    struct transmission *sent = send_at(telegram, number, begin);
    if (!sent) return;
    counted.telegrams++;
    if (begin - now > bits(1)) counted.held++;
    if (token_at && (number != token_from || !is_token)) {
        keep(counted.answer, &counted.answers, begin - token_at);
        if (begin - token_at > bits(t_sl)) counted.late_tokens++;
        token_at = 0;
    }
    if (is_token) count_token(sent, repeated);
    else if (repeated) counted.repeats++;
    for (int n = 0; n < station_count; n++) stations[n].last.count = 0;
    station->last = *telegram;
    station->free_at = sent->end + idle;
    counted.ruled += bits(11 * telegram->count) + idle;
}

/* A master's telegram has come to its end: the slave that it asks begins. */
static void answer(const struct transmission *request)
{
    struct telegram octets;
    struct station *station = &stations[request->sender];
    if (request->spoilt_from < request->telegram.count) return;
    answer_to(&request->telegram, &octets);
    if (!octets.count) return;
    struct transmission *back = send_at(&octets, -1, request->end + bits(min_tsdr));
    if (back) station->free_at = back->end + bits(t_id1);
    station->last.count = 0;
    counted.ruled += bits(min_tsdr + 11 * octets.count);
}

static void take(int number)
{
    struct station *station = &stations[number];
    const ssize_t got = read(station->fd, station->buffer + station->filled, BUFFER - station->filled);
    const ns_t now = now_ns();
    if (got <= 0) return;
    station->filled += got;
    int done = 0;
    while (done < station->filled) {
        const uint8_t *front = station->buffer + done;
        int size = length(front, station->filled - done);
        if (!size) break;
        struct telegram telegram = {.count = size < 0 ? 1 : size};
        memcpy(telegram.octets, front, telegram.count);
        transmit(number, &telegram, now);
        done += telegram.count;
    }
    memmove(station->buffer, station->buffer + done, station->filled -= done);
}

/* When the next portion of a transmission has arrived. */
static ns_t portion_at(const struct transmission *sent)
{
    int upto = sent->handed + (int)slice;
    if (upto > sent->telegram.count) upto = sent->telegram.count;
    return sent->begin + bits(11 * upto);
}

static void hand_over(struct transmission *sent, ns_t now)
{
    int upto = (int)((now - sent->begin) / (11 * bit_ns));
    if (now >= sent->end || upto > sent->telegram.count) upto = sent->telegram.count;
    if (upto <= sent->handed) upto = sent->handed + 1;
    for (int n = sent->handed > sent->spoilt_from ? sent->handed : sent->spoilt_from; n < upto; n++)
        sent->telegram.octets[n] ^= 0xFF;
    for (int n = 0; n < station_count; n++)
        if (n != sent->sender && write(stations[n].fd, sent->telegram.octets + sent->handed, upto - sent->handed) < 0)
            counted.dropped++;
    sent->handed = upto;
}

/* Hand over what has arrived; when the next portion does. */
static ns_t deliver(ns_t now)
{
    ns_t next = NEVER;
    for (int n = 0; n < wire_count; n++) {
        struct transmission *sent = &on_wire[n];
        if (portion_at(sent) <= now) hand_over(sent, now);
        if (sent->handed == sent->telegram.count) {
            const struct transmission over = *sent;
            *sent = on_wire[--wire_count];
            n--;
            if (over.sender >= 0) answer(&over);
        } else if (portion_at(sent) < next) {
            next = portion_at(sent);
        }
    }
    return next;
}

/* --- orders --- */

static void print_list(const char *name, const uint32_t *values, int count)
{
    const int from = count > KEPT ? count - KEPT : 0;
    printf(", \"%s\": [", name);
    for (int n = from; n < count; n++) printf(n > from ? ", %u" : "%u", values[n % KEPT]);
    printf("]");
}

static void report(void)
{
    printf("{\"took_ns\": %lld, \"ruled_ns\": %lld, \"telegrams\": %ld, \"exchanges\": %ld, \"tokens\": %ld, "
           "\"token_repeats\": %ld, \"claims\": %ld, \"repeats\": %ld, \"collisions\": %ld, \"held\": %ld, "
           "\"dropped\": %ld, \"late_tokens\": %ld",
           (long long)(now_ns() - counted.begin), (long long)counted.ruled, counted.telegrams, counted.exchanges,
           counted.tokens, counted.token_repeats, counted.claims, counted.repeats, counted.collisions, counted.held,
           counted.dropped, counted.late_tokens);
    print_list("rotations_ns", counted.rotation, counted.rotations);
    print_list("answers_ns", counted.answer, counted.answers);
    printf("}\n");
    fflush(stdout);
}

/* Obey what standard input has; 0 at its end. */
static int obey(void)
{
    static char line[64];
    static size_t filled;
    char octet;
    ssize_t got;
    while ((got = read(0, &octet, 1)) == 1) {
        if (octet != '\n') {
            if (filled < sizeof line - 1) line[filled++] = octet;
            continue;
        }
        line[filled] = 0;
        filled = 0;
        if (!strcmp(line, "begin")) {
            memset(&counted, 0, sizeof counted);
            counted.begin = now_ns();
            round_at = 0;
        } else if (!strcmp(line, "end")) {
            report();
        }
    }
    return got != 0;
}

/* --- set-up --- */

static int hex(const char *text, uint8_t *out, int most)
{
    int count = 0;
    unsigned octet;
    while (count < most && sscanf(text + 2 * count, "%2x", &octet) == 1) out[count++] = octet;
    return count;
}

static int add_slave(const char *words)
{
    struct slave *slave = &slaves[slave_count++];
    char ident[8], config[2 * OCTETS + 1];
    if (sscanf(words, "%d:%7[0-9a-fA-F]:%510[0-9a-fA-F]:%d:%d", &slave->address, ident, config, &slave->inputs,
               &slave->outputs) != 5
        || slave->inputs > 244 || slave->outputs > 244)
        return 0;
    slave->owner = 255;
    slave->kept_sa = slave->kept_fcb = -1;
    slave->config_count = hex(config, slave->config, OCTETS);
    return hex(ident, slave->ident, 2) == 2;
}

static void add_station(void)
{
    struct station *station = &stations[station_count];
    struct termios raw;
    station->fd = posix_openpt(O_RDWR | O_NOCTTY);
    if (station->fd < 0 || grantpt(station->fd) || unlockpt(station->fd)) fail("no pty");
    station->far = open(ptsname(station->fd), O_RDWR | O_NOCTTY); /* stays open: nothing hangs up between two programs */
    if (station->far < 0 || tcgetattr(station->far, &raw)) fail("no pty");
    cfmakeraw(&raw);
    if (tcsetattr(station->far, TCSANOW, &raw)) fail("pty");
    fcntl(station->fd, F_SETFL, O_NONBLOCK);
    printf("%s\"%s\"", station_count ? ", " : "{\"ports\": [", ptsname(station->fd));
    station_count++;
}

static int run(void)
{
    struct pollfd waits[STATIONS + 1] = {{.fd = 0, .events = POLLIN}};
    ns_t look_until = 0;
    for (int n = 0; n < station_count; n++) waits[n + 1] = (struct pollfd){.fd = stations[n].fd, .events = POLLIN};
    for (;;) {
        const ns_t next = deliver(now_ns()), now = now_ns();
        struct timespec wait = {0, 0};
        if (next != NEVER) look_until = now + LOOK;
        if (next == NEVER ? now > look_until : next - now > SPIN) {
            const ns_t sleep = next == NEVER ? 1000000000 : next - now - SPIN / 2;
            wait = (struct timespec){sleep / 1000000000, sleep % 1000000000};
        }
        if (ppoll(waits, station_count + 1, &wait, NULL) <= 0) continue;
        if (waits[0].revents && !obey()) return 0;
        for (int n = 0; n < station_count; n++)
            if (waits[n + 1].revents & POLLIN) {
                take(n);
                look_until = now_ns() + LOOK;
            }
    }
}

int main(int argc, char **argv)
{
    if (argc < 8) {
        fprintf(stderr, "segment BAUD T_ID1 T_ID2 MIN_TSDR T_SL SLICE STATIONS [ADDRESS:IDENT:CONFIG:INPUTS:OUTPUTS ...]\n");
        return 2;
    }
    bit_ns = 1e9 / atol(argv[1]);
    t_id1 = atol(argv[2]);
    t_id2 = atol(argv[3]);
    min_tsdr = atol(argv[4]);
    t_sl = atol(argv[5]);
    slice = atol(argv[6]) < 1 ? 1 : atol(argv[6]);
    for (int n = 8; n < argc; n++)
        if (slave_count == SLAVES || !add_slave(argv[n])) {
            fprintf(stderr, "segment: no slave: %s\n", argv[n]);
            return 2;
        }
    if (atol(argv[7]) < 1 || atol(argv[7]) > STATIONS) {
        fprintf(stderr, "segment: 1 to %d stations\n", STATIONS);
        return 2;
    }
    for (long n = atol(argv[7]); n; n--) add_station();
    printf("]}\n");
    fflush(stdout);
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0); /* sleeps end in time */
    setpriority(PRIO_PROCESS, 0, -20); /* where it is permitted: other programs shall not change the wire's time */
    fcntl(0, F_SETFL, O_NONBLOCK);
    counted.begin = now_ns();
    return run();
}
