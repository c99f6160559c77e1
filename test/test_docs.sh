#!/bin/sh
# What README.md and doc/*.md say is there: link targets and anchors, functions named in a link to a source file, files, make targets, options
# of ./mlt, every row of the slide map, formulas that GitHub's Markdown leaves alone, and figures that their program draws again.
# Then a small document with one fault planted at a time, each of which must be caught.
#
#     test/test_docs.sh ./mlt          run from the project's root
. "$(dirname "$0")/check.sh"
mlt=$1

"$mlt" --help >"$folder/help" 2>/dev/null || { echo "test_docs: cannot run '$mlt --help'"; echo "0 passed, 1 failed"; exit 1; }

good() { passed=$((passed + 1)); }
bad() { failed=$((failed + 1)); echo "$doc: $1"; }

# all [text](target) outside of fenced code: text, tab, target
links() {
    awk '/^```/ { code = !code; next } code { next } {
        while (match($0, /\[[^]]*\]\([^)]*\)/)) {
            link = substr($0, RSTART, RLENGTH); $0 = substr($0, RSTART + RLENGTH)
            at = index(link, "](")
            print substr(link, 2, at - 2) "\t" substr(link, at + 2, length(link) - at - 2)
        } }' "$1"
}

# all code, fenced, indented or in backticks, a piece on each line
code() {
    awk '/^```/ { code = !code; next } code || /^    / { print; next } { n = split($0, part, "`"); for (i = 2; i < n; i += 2) print part[i] }' "$1"
}

# headings as the anchors that GitHub makes of them
anchors() {
    awk '/^```/ { code = !code; next } !code && /^#+ / { sub(/^#+ /, ""); print }' "$1" | tr 'A-Z ' 'a-z-' | tr -cd 'a-z0-9_\n-'
}

# whether a name occurs in a file as a word
names() { grep -Eq "(^|[^A-Za-z0-9_])$1([^A-Za-z0-9_]|\$)" "$2"; }

check_links() {
    links "$1" >"$folder/links"
    while IFS='	' read -r text target; do
        file=${target%%#*} anchor=
        case $target in
        http://*|https://*|mailto:*) continue ;;
        *'#'*) anchor=${target#*#} ;;
        esac
        path=$1
        [ -z "$file" ] || path=$(dirname "$1")/$file
        if [ ! -e "$path" ]; then bad "no file for the link to '$target'"; continue; fi
        if [ -n "$anchor" ] && ! anchors "$path" | grep -Fqx -e "$anchor"; then bad "no heading for the link to '$target'"; continue; fi
        case $text in
        \`*.*\`) [ "\`$(basename "$file")\`" = "$text" ] || { bad "a link that says $text leads to '$target'"; continue; } ;;
        \`*\`)
            name=${text#?}
            name=${name%?}
            case $file in *.c|*.h|*.sh) names "$name" "$path" || { bad "no '$name' in '$file'"; continue; } ;; esac ;;
        esac
        good
    done <"$folder/links"
}

check_options() {
    awk '{ while (match($0, /(^|[^-A-Za-z0-9])--[a-z][a-z0-9-]*/)) { word = substr($0, RSTART, RLENGTH); sub(/^[^-]/, "", word); print word; $0 = substr($0, RSTART + RLENGTH) } }' "$1" |
        sort -u >"$folder/options"
    while read -r option; do
        if grep -Eq "(^|[^-A-Za-z0-9])$option([^-A-Za-z0-9]|\$)" "$folder/help"; then good; else bad "mlt has no option $option"; fi
    done <"$folder/options"
}

# NAME.obj, OUT.c and the like stand for any name
check_files() {
    code "$1" | tr -s " \"'=,;()" '\n' | grep -E '^[A-Za-z0-9_./-]+\.(c|h|sh|md|obj|mtl|cam|svg)$' | grep -Ev '(^|/)[A-Z]+\.[a-z]+$' | sort -u >"$folder/files"
    while read -r file; do
        found=
        for place in "$(dirname "$1")" "$root" "$root/test" "$root/scenes"; do [ ! -e "$place/$file" ] || found=yes; done
        if [ -n "$found" ]; then good; else bad "no file '$file'"; fi
    done <"$folder/files"
}

check_targets() {
    code "$1" | awk '{
        gsub(/(&&|\||;|#.*|`)/, " ; ")
        for (i = 1; i <= NF; i++) {
            if ($i == ";") make = 0
            else if (make && $i !~ /=/ && $i ~ /^[A-Za-z0-9_.\/-]+$/ && $i !~ /^-/) print $i
            if ($i == "make") make = 1
        }
        make = 0 }' | sort -u >"$folder/targets"
    while read -r target; do
        case $target in
        build/*/*) [ -e "$root/test/$(basename "$target").c" ] && { good; continue; } ;;
        *) grep -Eq "^([A-Za-z0-9_.-]+ )*$target( [A-Za-z0-9_.-]+)* *:([^=]|\$)" "$root/Makefile" && { good; continue; } ;;
        esac
        bad "no 'make $target'"
    done <"$folder/targets"
}

# every row of the slide map names a function and a test, as links to where they are (which check_links follows)
check_map() {
    rows=$(awk -F '|' '/^## / { map = /slides, one by one/ } map && /^\|/ && !/^\| (slide|---) / {
            rows++
            if ($4 !~ /\[`[A-Za-z0-9_]+`\]\(/ || $5 !~ /\[`[A-Za-z0-9_]+`\]\([^)]*test/) print "slide without a function or a test:" $2 >"'"$folder/map"'" }
        END { print rows + 0 }' "$1")
    [ "$rows" -eq 0 ] || good
    [ ! -s "$folder/map" ] || bad "$(cat "$folder/map")"
    rm -f "$folder/map"
}

# Markdown takes * and a _ that does not follow a letter or digit for emphasis, | for a column; an odd $ opens what nothing closes
check_maths() {
    awk '/^```/ { code = !code; next } code || /^    / { next } /^\$\$.*\$\$$/ { $0 = substr($0, 2, length($0) - 2) } {
        gsub(/`[^`]*`/, "")
        n = split($0, part, "$")
        if (n > 0 && n % 2 == 0) { print "line " NR ": odd number of $"; next }
        for (i = 2; i < n; i += 2) if (part[i] ~ /[*<>|]|[^A-Za-z0-9]_|^_/) print "line " NR ": Markdown would change " part[i] }' "$1" >"$folder/maths"
    if [ -s "$folder/maths" ]; then bad "$(cat "$folder/maths")"; else good; fi
}

# all documents below $root
check_documents() {
    for page in "$root"/README.md "$root"/doc/*.md; do
        doc=${page#"$root"/}
        if [ ! -f "$page" ]; then bad 'is missing'; continue; fi
        check_links "$page"
        check_options "$page"
        check_files "$page"
        check_targets "$page"
        check_map "$page"
        check_maths "$page"
    done
}

root=.
check_documents

# the lecture has 35 slides; two lines are the table's head
doc=doc/lecture.md
[ "$(awk '/^## / { map = /slides, one by one/ } map && /^\|/' doc/lecture.md | wc -l)" -eq 37 ] && good || bad 'a slide has no row in the map'

# figures are what their program draws
doc=doc/figures.c
mkdir "$folder/figures"
if ${CC:-cc} doc/figures.c -o "$folder/draw" 2>"$folder/cc" && "$folder/draw" "$folder/figures"; then
    for figure in "$folder"/figures/*.svg; do
        if cmp -s "$figure" "doc/figures/$(basename "$figure")"; then good; else bad "does not draw doc/figures/$(basename "$figure") as it is"; fi
    done
else bad "cannot be built or run: $(head -n 1 "$folder/cc")"; fi

# scripts are shell, and those beside the documents are named in one
for doc in doc/*.sh test/*.sh; do
    if sh -n "$doc" 2>"$folder/sh"; then good; else bad "$(head -n 1 "$folder/sh")"; fi
    case $doc in doc/*) if grep -Fq "$doc" doc/*.md; then good; else bad 'is named in no document'; fi ;; esac
done

# every figure is shown somewhere
for figure in doc/figures/*; do
    doc=$figure
    if grep -Fq "figures/$(basename "$figure"))" README.md doc/*.md; then good; else bad 'is shown in no document'; fi
done

# planted faults
root=$folder/root
mkdir -p "$root/doc" "$root/test"
: >"$root/README.md"
echo 'double path_length(void);' >"$root/path.h"
echo 'static void test_length(void) {}' >"$root/test/test_path.c"
printf 'demo: mlt\n\techo\n' >"$root/Makefile"
small='# A document

See [below](#the-slides-one-by-one), [`path.h`](../path.h) and `test_path.c`; `mlt --help`; `make demo`; `make build/main/test_path`; $x_1 + y_2$.

## The slides, one by one

| slide | formula | function | test |
| --- | --- | --- | --- |
| one | $l$ | [`path_length`](../path.h) | [`test_length`](../test/test_path.c) |'
plant() {
    printf '%s\n%s\n' "$small" "$2" >"$root/doc/small.md"
    found=$(failed=0; check_documents >"$folder/said"; echo "$failed")
    if [ "$found" = "$1" ]; then good; else doc=self-test; bad "$found faults found for $1 planted: $2"; cat "$folder/said"; fi
}
plant 0 ''
plant 1 'See [this](no-such-file.c).'
plant 1 'See [this](#no-such-heading).'
plant 1 'See [this](../path.h#no-such-heading).'
plant 1 'See [`path_width`](../path.h).'
plant 1 'See [`path_leng`](../path.h).'
plant 1 'See [`path.h`](../test/test_path.c).'
plant 1 'See `no-such-file.c`.'
plant 1 '    mlt scenes/no-such-scene.obj'
plant 1 'Say `mlt --no-such-option`.'
plant 1 'Say `make no-such-target`.'
plant 1 'Say `make ARCH= demo no-such-target && ./mlt`.'
plant 1 'Say `make build/main/test_no_such_test`.'
plant 1 '| two | $l$ | `path_length` | [`test_length`](../test/test_path.c) |'
plant 1 '| two | $l$ | [`path_length`](../path.h) | none |'
plant 1 'The sum $f(x)_1$ is wrong.'
plant 1 'It costs $ 5.'

report
