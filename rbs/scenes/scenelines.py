"""Lines of scene and constraint files: taken apart, with commas between the numbers as blanks."""

import re

import numpy as np

# The end of a mesh file's name, with what separates it from the numbers behind it.
_NAME_END = re.compile(r"\.(?:mesh|off)(?=[\s,])", re.IGNORECASE)

# A comment line that suggests settings: "# suggests friction 0.5".
_SUGGESTION = re.compile(r"\s*#+\s*suggests\s+(.*)")


def fields_of(line):
    """The fields of a line, a list of str; what follows a `#` is a comment.

    The coursework's text prints commas between the numbers. They count as blanks, but for those in
    the name of a mesh file.
    """
    line = line.split("#", 1)[0]
    ends = [match.end() for match in _NAME_END.finditer(line)]
    end = ends[-1] if ends else 0
    return line[:end].split() + line[end:].replace(",", " ").split()


def scene_rows(text, count):
    """The bodies of a scene, with the numbers as they stand in its file.

    text : of a scene file that `load_scene_file` has accepted, so that nothing can be wrong with it
    count : how many bodies it has found
    Returns a list of (mesh file, density, isFixed, position (1, 3), orientation (1, 4)).
    """
    lines = [fields for fields in map(fields_of, text.splitlines()) if fields]
    rows = []
    for fields in lines[1 : count + 1]:
        name = " ".join(fields[:-9]).replace("\\", "/")
        density, isFixed, *numbers = fields[-9:]
        numbers = np.array(numbers, dtype=np.float64)
        position, orientation = numbers[:3].reshape(1, 3), numbers[3:].reshape(1, 4)
        rows.append((name, float(density), bool(int(isFixed)), position, orientation))
    return rows


def suggestion_lines(text):
    """The words of a scene's comment lines that begin with `# suggests`.

    Returns a list of (line number, list of words).
    """
    found = ((k, _SUGGESTION.match(line)) for k, line in enumerate(text.splitlines(), start=1))
    return [(number, match[1].split()) for number, match in found if match]
