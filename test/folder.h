/* A folder of the test's own for the files it writes: under TMPDIR, or the current folder; made when it is first asked for, removed with all that is
 * in it when the program exits. What cannot be made or written ends the program: it is no test's failure. */
#ifndef FOLDER_H
#define FOLDER_H
#include <dirent.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { FOLDER_PATH = 4096 };
static char folder_name[FOLDER_PATH];              /* empty: not there */

static inline void folder_join(char out[FOLDER_PATH], const char *place, const char *name)
{
    int n = snprintf(out, FOLDER_PATH, "%s/%s", place, name);
    if (n > 0 && n < FOLDER_PATH) return;
    fprintf(stderr, "%s/%s: too long a name\n", place, name);
    exit(2);
}

/* How many entries a folder has, those of folders in it not counted; with 'unlinked' they are removed as they are counted, those of folders too. */
static inline int folder_entries(const char *place, bool unlinked)
{
    DIR *directory = opendir(place);
    int n = 0;
    for (struct dirent *entry; directory && (entry = readdir(directory));) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
        char path[FOLDER_PATH];
        n++;
        folder_join(path, place, entry->d_name);
        if (!unlinked || unlink(path) == 0) continue;
        folder_entries(path, true);
        rmdir(path);
    }
    if (directory) closedir(directory);
    return n;
}

/* True if nothing of it is left. Called at exit too. */
static inline bool folder_remove(void)
{
    if (!folder_name[0]) return true;
    folder_entries(folder_name, true);
    bool gone = rmdir(folder_name) == 0;
    folder_name[0] = 0;
    return gone;
}
static inline void folder_at_exit(void) { folder_remove(); }

static inline const char *folder(void)
{
    static bool asked;
    if (folder_name[0]) return folder_name;
    const char *place = getenv("TMPDIR");
    folder_join(folder_name, place && place[0] ? place : ".", "mlt-test-XXXXXX");
    if (!mkdtemp(folder_name)) {
        perror(folder_name);
        folder_name[0] = 0;
        exit(2);
    }
    if (!asked) atexit(folder_at_exit);
    asked = true;
    return folder_name;
}

/* Stays until the next call but one. */
static inline const char *folder_path(const char *name)
{
    static char path[2][FOLDER_PATH];
    static int turn;
    turn = !turn;
    folder_join(path[turn], folder(), name);
    return path[turn];
}

static inline void folder_write(const char *name, const void *data, size_t n)
{
    const char *path = folder_path(name);
    FILE *file = fopen(path, "wb");
    if (file && fwrite(data, 1, n, file) == n && fclose(file) == 0) return;
    perror(path);
    exit(2);
}
static inline void folder_write_text(const char *name, const char *text) { folder_write(name, text, strlen(text)); }
#endif
