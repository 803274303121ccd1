/* Convolves a WAV file with the response of a room, in another WAV file:
 *
 *     convolve_wav dry.wav room.wav wet.wav
 *
 * Samples of 16 bits or floats; one response for all channels, or one for each. Without arguments it makes a click and a decaying
 * response itself, and compares the result with the sum that it should be. */
#include "fvi_streams.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { BLOCK = 4096, MOST_CHANNELS = 16 };

typedef struct {
    uint32_t rate, channels;
    size_t count;
    float *samples[MOST_CHANNELS];
} Sound;

static void stop(const char *what, const char *why) {
    fprintf(stderr, "%s: %s\n", what, why);
    exit(1);
}

static void check(const char *what, enum FviStreamStatus status) {
    if (status != FVI_STREAM_STATUS_OK) stop(what, fvi_stream_status_text((int32_t)status));
}

static void *room_for(size_t count, size_t size) {
    void *place = calloc(count ? count : 1, size);
    if (!place) stop("convolve_wav", "out of memory");
    return place;
}

static void forget(Sound *sound) {
    for (uint32_t channel = 0; channel < sound->channels; ++channel) free(sound->samples[channel]);
}

static uint32_t number(const unsigned char *bytes, int count) {
    uint32_t value = 0;
    for (int i = count; i-- > 0;) value = value << 8 | bytes[i];
    return value;
}

static Sound read_wav(const char *path) {
    FILE *file = fopen(path, "rb");
    unsigned char head[12], chunk[8], form[26] = {0}, *data = NULL;
    size_t size = 0;
    if (!file) stop(path, "cannot be read");
    if (fread(head, 1, 12, file) != 12 || memcmp(head, "RIFF", 4) || memcmp(head + 8, "WAVE", 4)) stop(path, "is no WAV file");
    while (!data && fread(chunk, 1, 8, file) == 8) {
        size = number(chunk + 4, 4);
        if (!memcmp(chunk, "fmt ", 4) && size >= 16) {
            size_t part = size < sizeof form ? 16 : sizeof form;
            if (fread(form, 1, part, file) != part) stop(path, "ends too early");
            size -= part;
        } else if (!memcmp(chunk, "data", 4)) {
            data = room_for(size, 1);
            size = fread(data, 1, size, file);
            break;
        }
        if (fseek(file, (long)(size + size % 2), SEEK_CUR)) stop(path, "ends too early");
    }
    fclose(file);
    /* 1: integers, 3: floats, 65534: what the longer description says. */
    uint32_t bits = number(form + 14, 2), kind = number(form, 2) == 65534 ? number(form + 24, 2) : number(form, 2);
    Sound sound = {.rate = number(form + 4, 4), .channels = number(form + 2, 2)};
    if (!data) stop(path, "has no samples");
    if (!(kind == 1 && bits == 16) && !(kind == 3 && bits == 32)) stop(path, "has neither samples of 16 bits nor floats of 32");
    if (sound.channels == 0 || sound.channels > MOST_CHANNELS) stop(path, "has no channel, or more than 16");
    sound.count = size / (bits / 8) / sound.channels;
    for (uint32_t channel = 0; channel < sound.channels; ++channel) {
        sound.samples[channel] = room_for(sound.count, sizeof(float));
        for (size_t k = 0; k < sound.count; ++k) {
            uint32_t raw = number(data + (k * sound.channels + channel) * (bits / 8), (int)bits / 8);
            if (bits == 16) sound.samples[channel][k] = (float)(int16_t)(uint16_t)raw / 32768.0f;
            else memcpy(&sound.samples[channel][k], &raw, 4);
        }
    }
    free(data);
    return sound;
}

static void put(FILE *file, uint32_t value, int count) {
    for (int i = 0; i < count; ++i) fputc((int)(value >> 8 * i & 255u), file);
}

static void write_wav(const char *path, const Sound *sound) {
    FILE *file = fopen(path, "wb");
    if (!file) stop(path, "cannot be written");
    uint32_t frame = 4 * sound->channels, size = (uint32_t)sound->count * frame;
    fputs("RIFF", file), put(file, 36 + size, 4), fputs("WAVEfmt ", file);
    put(file, 16, 4), put(file, 3, 2), put(file, sound->channels, 2), put(file, sound->rate, 4);
    put(file, sound->rate * frame, 4), put(file, frame, 2), put(file, 32, 2);
    fputs("data", file), put(file, size, 4);
    for (size_t k = 0; k < sound->count; ++k) {
        for (uint32_t channel = 0; channel < sound->channels; ++channel) {
            uint32_t raw;
            memcpy(&raw, &sound->samples[channel][k], 4);
            put(file, raw, 4);
        }
    }
    if (fclose(file)) stop(path, "cannot be written");
}

/* The sound, until the response has died away. */
static Sound convolved(const Sound *sound, const Sound *room) {
    uint32_t channels = sound->channels;
    if (sound->rate != room->rate) stop("convolve_wav", "sound and response differ in their samples per second");
    if (room->channels != 1 && room->channels != channels) stop("convolve_wav", "neither one response nor one for each channel");
    /* A matrix of inputs and outputs, of which only the diagonal has responses. */
    FviResponseF32 *responses = room_for((size_t)channels * channels, sizeof *responses);
    for (uint32_t i = 0; i < channels; ++i) {
        responses[i * channels + i] = (FviResponseF32){room->samples[room->channels == 1 ? 0 : i], room->count};
    }
    FviStream stream = {.block = BLOCK};
    FviConvolverF32 *convolver = NULL;
    check("responses", fvi_convolver_new_f32(responses, channels, channels, &stream, &convolver));
    free(responses);
    Sound wet = {.rate = sound->rate, .channels = channels, .count = sound->count + room->count - 1};
    for (uint32_t i = 0; i < channels; ++i) {
        wet.samples[i] = room_for(wet.count, sizeof(float));
        memcpy(wet.samples[i], sound->samples[i], sound->count * sizeof(float));
    }
    for (size_t k = 0; k < wet.count; k += BLOCK) {
        const float *inputs[MOST_CHANNELS];
        float *outputs[MOST_CHANNELS];
        for (uint32_t i = 0; i < channels; ++i) inputs[i] = outputs[i] = wet.samples[i] + k;
        check("sound", fvi_convolver_process_f32(convolver, inputs, outputs, wet.count - k < BLOCK ? wet.count - k : BLOCK));
    }
    fvi_convolver_free_f32(convolver);
    return wet;
}

/* A click and half a second of noise that decays; the result is the noise, half as loud. */
static int made(void) {
    Sound click = {.rate = 48000, .channels = 2, .count = 48000}, room = {.rate = 48000, .channels = 1, .count = 24000};
    uint32_t state = 1;
    for (int i = 0; i < 2; ++i) click.samples[i] = room_for(click.count, sizeof(float));
    click.samples[0][0] = click.samples[1][100] = 0.5f;
    room.samples[0] = room_for(room.count, sizeof(float));
    for (size_t n = 0; n < room.count; ++n) {
        state = state * 1664525u + 1013904223u;
        room.samples[0][n] = ((float)state / 4294967296.0f - 0.5f) * expf(-6.0f * (float)n / 24000.0f);
    }
    write_wav("dry.wav", &click);
    write_wav("room.wav", &room);
    Sound dry = read_wav("dry.wav"), response = read_wav("room.wav"), wet = convolved(&dry, &response);
    write_wav("wet.wav", &wet);
    Sound again = read_wav("wet.wav");
    float worst = 0.0f;
    for (size_t k = 0; k < again.count; ++k) {
        float left = k < room.count ? 0.5f * room.samples[0][k] : 0.0f;
        float right = k >= 100 && k - 100 < room.count ? 0.5f * room.samples[0][k - 100] : 0.0f;
        worst = fmaxf(worst, fmaxf(fabsf(again.samples[0][k] - left), fabsf(again.samples[1][k] - right)));
    }
    printf("wet.wav: %u channels, %.3f s, error %.1e\n", again.channels, (double)again.count / again.rate, (double)worst);
    int wrong = again.channels != 2 || !(worst < 1e-6f);
    forget(&click), forget(&room), forget(&dry), forget(&response), forget(&wet), forget(&again);
    return wrong;
}

int main(int count, char **arguments) {
    if (count == 1) return made();
    if (count != 4) stop("usage", "convolve_wav dry.wav room.wav wet.wav");
    Sound dry = read_wav(arguments[1]), room = read_wav(arguments[2]), wet = convolved(&dry, &room);
    write_wav(arguments[3], &wet);
    printf("%s: %u channels, %.3f s\n", arguments[3], wet.channels, (double)wet.count / wet.rate);
    forget(&dry), forget(&room), forget(&wet);
    return 0;
}
