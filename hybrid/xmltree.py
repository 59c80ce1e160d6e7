"""XML text -> a tree of elements that know their line; nothing that XML could do beyond that.

Stage 1. Entities may not be declared, nothing outside the text is ever read (a DOCTYPE may name a DTD),
and size and depth are limited, so that no small file can unfold into a huge one or read another.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from hybrid.errors import PatchError, Place, quoted

# A tag with its attributes, and the name of an entity in it that XML does not know by itself.
_TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_ENTITY = re.compile(rb"&(?!(?:amp|lt|gt|quot|apos);|#)([^;\s]*);?")

# The declaration that an XML file may begin with, and the encodings that it may name.
_DECLARED = re.compile(rb"""<\?xml\s[^>]*?\sencoding\s*=\s*(?:"([^">]*)"|'([^'>]*)')""")
ENCODINGS = ("UTF-8", "UTF-16", "ISO-8859-1", "US-ASCII", "Windows-1252")
_WIDE = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}

MOST_ELEMENTS = 500_000
DEEPEST_NESTING = 100


@dataclass(slots=True)
class Element:
    """One element: tag without its prefix, the text in it without comments, the line it begins in."""

    tag: str
    attributes: dict[str, str]
    place: Place
    children: list[Element] = field(default_factory=list)
    parts: list[str] = field(default_factory=lambda: [""])  # texts before, between and after them

    @property
    def text(self) -> str:
        """All of its own text, run together."""
        return "".join(self.parts)

    def all(self, tag: str) -> Iterator[Element]:
        """The children of that tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, *tags: str) -> Element | None:
        """The first child of one of these tags."""
        return next((child for child in self.children if child.tag in tags), None)

    def required(self, name: str) -> str:
        """An attribute that must be there."""
        value = self.attributes.get(name, "").strip()
        if not value:
            raise PatchError(f"<{self.tag}> has no {name}; give one", self.place)
        return value


def encoding_of(content: bytes) -> str:
    """How the bytes of a file are to be read: one of `ENCODINGS`, by the declaration if it is XML.

    UTF-16 is known by its first two bytes, as XML requires, and by the declaration that they lead to;
    all that declares nothing is UTF-8. Raises ValueError with a message for another encoding, and
    where the declaration and the bytes differ.
    """
    wide = _WIDE.get(content[:2])
    head = content[2:1026].decode(wide, "ignore").encode("ascii", "replace") if wide else content
    found = _DECLARED.match(head.removeprefix(codecs.BOM_UTF8))
    name = (found[1] or found[2] or b"").decode("ascii", "replace") if found else ""
    if not found:
        if wide and not head.startswith(b"<?xml"):
            raise ValueError("a text in UTF-16; save it as UTF-8")
        return "UTF-16" if wide else "UTF-8"
    declared = next((known for known in ENCODINGS if known.lower() == name.lower()), None)
    if declared is None:
        raise ValueError(
            f"declares the encoding {quoted(name)}; those read are {', '.join(ENCODINGS)}"
        )
    if (declared == "UTF-16") != bool(wide):
        is_ = "in UTF-16" if wide else "not in UTF-16, which begins with a byte order mark"
        raise ValueError(f"declares the encoding {name}, but is {is_}; declare what it is")
    return declared


def read_xml(text: str, file: str) -> Element:
    """The root element; raises PatchError with the line of whatever is wrong."""
    source = text.encode("utf-8", "replace")
    builder = _Builder(file, source)
    try:
        builder.parser.Parse(source, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise PatchError(f"not well-formed XML: {reason}", Place(file, error.lineno)) from None
    assert builder.root is not None  # expat refuses a text without elements
    return builder.root


class _Builder:
    """Makes the tree from the parser's events."""

    def __init__(self, file: str, source: bytes) -> None:
        self.file = file
        self.source = source
        self.root: Element | None = None
        self.open: list[Element] = []
        self.pieces: list[str] = []
        self.count = 0
        self.parser = parser = expat.ParserCreate("UTF-8")
        parser.buffer_text = True
        parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)
        parser.StartElementHandler = self.start
        parser.EndElementHandler = self.end
        parser.CharacterDataHandler = self.data
        parser.EntityDeclHandler = self.refuse_entity
        parser.SkippedEntityHandler = self.refuse_reference
        parser.AttlistDeclHandler = self.refuse_defaults

    @property
    def place(self) -> Place:
        return Place(self.file, self.parser.CurrentLineNumber)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if self.count > MOST_ELEMENTS or len(self.open) >= DEEPEST_NESTING:
            most = f"{MOST_ELEMENTS} elements, nested {DEEPEST_NESTING} deep"
            raise PatchError(f"too large; at most {most}, are read", self.place)
        self.refuse_references_in_tag()
        element = Element(tag.rpartition(":")[2], attributes, self.place)
        if self.open:
            self.part_ends()
            self.open[-1].children.append(element)
            self.open[-1].parts.append("")
        else:
            self.root = element
        self.open.append(element)

    def end(self, _tag: str) -> None:
        self.part_ends()
        self.open.pop()

    def data(self, text: str) -> None:
        self.pieces.append(text)

    def part_ends(self) -> None:
        """What has been read of the text belongs to the innermost element."""
        self.open[-1].parts[-1] = "".join(self.pieces)
        self.pieces.clear()

    def refuse_entity(self, name: str, *_: object) -> None:
        raise PatchError(
            f"declares the entity {quoted(name)}; entities are not read, write their text itself",
            self.place,
        )

    def refuse_references_in_tag(self) -> None:
        """In attributes the parser drops what it does not know, and tells nobody."""
        tag = _TAG.match(self.source, self.parser.CurrentByteIndex)
        used = tag and _ENTITY.search(tag[0])
        if used:
            self.refuse_reference(used[1].decode())

    def refuse_defaults(self, tag: str, attribute: str, *_: object) -> None:
        raise PatchError(
            f"declares what <{tag}> has for {attribute}; declarations are not read, "
            "write the attribute where it belongs",
            self.place,
        )

    def refuse_reference(self, name: str, *_: object) -> None:
        raise PatchError(
            f"uses the entity {quoted(name)}; entities are not read, write its text itself",
            self.place,
        )
