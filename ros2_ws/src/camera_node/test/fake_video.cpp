// A camera of Video4Linux without a kernel that has one: loaded before the C library, it answers for one path.
//
// The environment says what it is like: FAKE_VIDEO its path, FAKE_VIDEO_FORMAT the four letters of its only format,
// FAKE_VIDEO_STICKY=1 an automatic exposure that cannot be switched off, FAKE_VIDEO_BROKEN=1 an exposure time that
// cannot be set, FAKE_VIDEO_DRIVER the name of its driver. While the file FAKE_VIDEO_UNPLUGGED names is
// there, it is unplugged. It exposes without end; every pixel of a frame is its number, and its stamp the end of the
// exposure by the steady clock. Chroma is 77.

#include <cerrno>
#include <cstdarg>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <dlfcn.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/mman.h>
#include <unistd.h>

namespace {
constexpr int columns = 64, rows = 48, most_buffers = 16, buffer_bytes = 65536;
constexpr int64_t period_ns = 20'000'000;
int queued[most_buffers], waiting = 0, number = 0;
int automatic = 3, exposure = 50; // of a webcam that sets itself
int64_t next_end_ns = 0;
bool ours[1024] = {};

bool unplugged() {
    const char *name = getenv("FAKE_VIDEO_UNPLUGGED");
    return name && access(name, F_OK) == 0;
}

uint32_t format() {
    const char *f = getenv("FAKE_VIDEO_FORMAT");
    return v4l2_fourcc(f[0], f[1], f[2], f[3]);
}

uint32_t bytes_per_pixel() { return format() == V4L2_PIX_FMT_GREY ? 1 : 2; }
uint32_t length() { return columns * rows * bytes_per_pixel(); }

void describe(v4l2_pix_format &pix) {
    pix = {};
    pix.width = columns;
    pix.height = rows;
    pix.pixelformat = format();
    pix.bytesperline = columns * bytes_per_pixel();
    pix.sizeimage = length();
    pix.field = V4L2_FIELD_NONE;
}

int open_fake() {
    int fd = memfd_create("fake_video", 0);
    if (fd >= 0 && ftruncate(fd, most_buffers * buffer_bytes) == 0 && fd < 1024) ours[fd] = true;
    return fd;
}

int control(v4l2_control &asked, bool set) {
    int *value = asked.id == V4L2_CID_EXPOSURE_AUTO       ? &automatic
                 : asked.id == V4L2_CID_EXPOSURE_ABSOLUTE ? &exposure
                                                          : nullptr;
    if (!value) return EINVAL;
    if (set && value == &automatic && getenv("FAKE_VIDEO_STICKY")) return EBUSY;
    if (set && value == &exposure && getenv("FAKE_VIDEO_BROKEN")) return EIO;
    if (set) *value = asked.value;
    asked.value = *value;
    return 0;
}

int dequeue(int fd, v4l2_buffer &buffer) {
    if (!waiting) return EAGAIN;
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    int64_t now_ns = now.tv_sec * 1'000'000'000LL + now.tv_nsec;
    if (next_end_ns == 0) next_end_ns = now_ns + period_ns;
    int64_t wait = next_end_ns - now_ns;
    if (wait > 0) {
        timespec pause{wait / 1'000'000'000, wait % 1'000'000'000};
        nanosleep(&pause, nullptr);
    }
    int index = queued[0];
    memmove(queued, queued + 1, --waiting * sizeof(int));
    uint8_t pixels[columns * rows * 2];
    if (format() == V4L2_PIX_FMT_YUYV)
        for (int k = 0; k < columns * rows; k++) pixels[2 * k] = number, pixels[2 * k + 1] = 77;
    else if (format() == V4L2_PIX_FMT_Y16)
        for (int k = 0; k < columns * rows; k++) pixels[2 * k] = number, pixels[2 * k + 1] = 3;
    else
        memset(pixels, number, sizeof pixels);
    if (pwrite(fd, pixels, length(), index * buffer_bytes) < 0) return EIO;
    buffer.index = index;
    buffer.length = buffer_bytes;
    buffer.bytesused = length();
    buffer.sequence = number++;
    buffer.flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    buffer.timestamp = {next_end_ns / 1'000'000'000, next_end_ns % 1'000'000'000 / 1000};
    next_end_ns += period_ns;
    return 0;
}

int answer(int fd, unsigned long request, void *data) {
    if (unplugged()) return ENODEV;
    switch (request) {
    case VIDIOC_QUERYCAP: {
        auto *it = static_cast<v4l2_capability *>(data);
        *it = {};
        const char *driver = getenv("FAKE_VIDEO_DRIVER");
        strcpy(reinterpret_cast<char *>(it->driver), driver ? driver : "fake");
        it->capabilities = it->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        return 0;
    }
    case VIDIOC_G_FMT:
    case VIDIOC_S_FMT:
    case VIDIOC_TRY_FMT: describe(static_cast<v4l2_format *>(data)->fmt.pix); return 0;
    case VIDIOC_G_PARM:
    case VIDIOC_S_PARM: {
        auto &capture = static_cast<v4l2_streamparm *>(data)->parm.capture;
        capture.capability = V4L2_CAP_TIMEPERFRAME;
        capture.timeperframe = {1, 50};
        return 0;
    }
    case VIDIOC_REQBUFS: return 0; // as many as are asked for
    case VIDIOC_QUERYBUF: {
        auto *it = static_cast<v4l2_buffer *>(data);
        it->length = buffer_bytes;
        it->m.offset = it->index * buffer_bytes;
        return 0;
    }
    case VIDIOC_QBUF: queued[waiting++] = static_cast<v4l2_buffer *>(data)->index; return 0;
    case VIDIOC_DQBUF: return dequeue(fd, *static_cast<v4l2_buffer *>(data));
    case VIDIOC_STREAMON: next_end_ns = 0; return 0;
    case VIDIOC_STREAMOFF: waiting = 0; return 0;
    case VIDIOC_G_CTRL: return control(*static_cast<v4l2_control *>(data), false);
    case VIDIOC_S_CTRL: return control(*static_cast<v4l2_control *>(data), true);
    default: return ENOTTY;
    }
}

int opened(const char *path) {
    const char *name = getenv("FAKE_VIDEO");
    if (!name || strcmp(path, name) != 0) return -2;
    if (unplugged()) {
        errno = ENOENT;
        return -1;
    }
    return open_fake();
}
} // namespace

extern "C" {
int open(const char *path, int flags, ...) {
    va_list list;
    va_start(list, flags);
    int mode = va_arg(list, int);
    va_end(list);
    int fd = opened(path);
    if (fd != -2) return fd;
    static auto real = reinterpret_cast<int (*)(const char *, int, int)>(dlsym(RTLD_NEXT, "open"));
    return real(path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    va_list list;
    va_start(list, flags);
    int mode = va_arg(list, int);
    va_end(list);
    int fd = opened(path);
    if (fd != -2) return fd;
    static auto real = reinterpret_cast<int (*)(const char *, int, int)>(dlsym(RTLD_NEXT, "open64"));
    return real(path, flags, mode);
}

int close(int fd) {
    if (fd >= 0 && fd < 1024) ours[fd] = false;
    static auto real = reinterpret_cast<int (*)(int)>(dlsym(RTLD_NEXT, "close"));
    return real(fd);
}

int ioctl(int fd, unsigned long request, ...) noexcept {
    va_list list;
    va_start(list, request);
    void *data = va_arg(list, void *);
    va_end(list);
    if (fd >= 0 && fd < 1024 && ours[fd]) {
        int error = answer(fd, request & 0xffffffff, data);
        if (!error) return 0;
        errno = error;
        return -1;
    }
    static auto real = reinterpret_cast<int (*)(int, unsigned long, void *)>(dlsym(RTLD_NEXT, "ioctl"));
    return real(fd, request, data);
}
}
