// power-cut LOG: lists the marks of a log of writes (dm-log-writes of Linux), as "ENTRY WORD" a line.
// power-cut LOG BEFORE DISK ENTRIES SEED: from the image BEFORE, of the disk when the log began, makes the image DISK: what it
// holds when the power is cut after that many entries. With a SEED that is not 0 its cache is lost: each write since its last
// flush arrived or not, at random.
//
// A log is a superblock and then, for each entry, one sector of head (a mark has its word in it) and the data. An ordinary write
// is logged once the flush after it is done, in front of that flush; a write past the cache (FUA) as soon as it is done.
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

enum { FLUSH = 1, FUA = 2, DISCARD = 4, MARK = 8 };
static const uint64_t MAGIC = 0x6a736677736872;

// Little-endian on the disk, as in this machine.
struct superblock {
  uint64_t magic, version, entries;
  uint32_t sector_bytes;
};
struct head {
  uint64_t sector, sectors, flags, bytes;
};

static int log_file;
static uint64_t sector_bytes;

static void stop(const char *why) {
  fprintf(stderr, "power-cut: %s\n", why);
  exit(1);
}

static void get(void *data, uint64_t bytes, uint64_t at) {
  if (pread(log_file, data, bytes, at) != (ssize_t)bytes) stop("cannot read the log");
}

static uint64_t after(uint64_t at, struct head head) {
  return at + sector_bytes * (1 + (head.flags & DISCARD ? 0 : head.sectors));
}

static int chance(uint64_t *seed) {
  *seed = *seed * 6364136223846793005u + 1442695040888963407u;
  return *seed >> 63;
}

static void copy(int source, off_t from, int disk, off_t to, uint64_t left) {
  static char data[1 << 16];
  while (left > 0) {
    uint64_t part = left < sizeof data ? left : sizeof data;
    if (pread(source, data, part, from) != (ssize_t)part) stop("cannot read what is to be copied");
    if (pwrite(disk, data, part, to) != (ssize_t)part) stop("cannot write the disk");
    from += part, to += part, left -= part;
  }
}

// Holes stay holes: an empty file system is little else.
static int copy_of(const char *image, const char *name) {
  int source = open(image, O_RDONLY), disk = open(name, O_WRONLY | O_CREAT | O_TRUNC, 0600);
  struct stat size;
  if (source < 0 || disk < 0 || fstat(source, &size) || ftruncate(disk, size.st_size)) stop("cannot copy the image");
  for (off_t end, data = 0; (data = lseek(source, data, SEEK_DATA)) >= 0; data = end) {
    end = lseek(source, data, SEEK_HOLE);
    copy(source, data, disk, data, end - data);
  }
  return disk;
}

int main(int count, char **words) {
  if (count != 2 && count != 6) return 2;
  log_file = open(words[1], O_RDONLY);
  struct superblock super;
  get(&super, sizeof super, 0);
  if (super.magic != MAGIC || super.version != 1) stop("not a log of writes");
  sector_bytes = super.sector_bytes;
  uint64_t entries = count == 2 ? super.entries : strtoull(words[4], NULL, 10);
  if (entries > super.entries) stop("the log has not that many entries");

  struct head head;
  uint64_t at = sector_bytes, flushed = 0;
  for (uint64_t entry = 0; entry < entries; entry++, at = after(at, head)) {
    get(&head, sizeof head, at);
    if (head.flags & FLUSH) flushed = entry;
    if (count == 2 && head.flags & MARK) {
      char word[512] = "";
      get(word, head.bytes < sizeof word ? head.bytes : sizeof word - 1, at + sizeof head);
      printf("%llu %s\n", (unsigned long long)entry, word);
    }
  }
  if (count == 2) return 0;

  int disk = copy_of(words[2], words[3]);
  uint64_t seed = strtoull(words[5], NULL, 10);
  int cached = seed != 0;
  at = sector_bytes;
  for (uint64_t entry = 0; entry < entries; entry++, at = after(at, head)) {
    get(&head, sizeof head, at);
    int lost = cached && entry > flushed && !(head.flags & FUA) && chance(&seed);
    // What a discarded sector holds is open; here, what it held before.
    if (!lost && !(head.flags & DISCARD))
      copy(log_file, at + sector_bytes, disk, head.sector * sector_bytes, head.sectors * sector_bytes);
  }
  return 0;
}
