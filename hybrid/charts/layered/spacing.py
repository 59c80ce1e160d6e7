"""How far apart things are kept, and from what size on less effort is made."""

PITCH = 11.0  # between two uprights, and between two nets that pass a column
MARGIN = 16.0  # from a box to the first upright
BOX_GAP = 22.0  # between two boxes of a column
PASS_GAP = 14.0  # between a box and a net that passes it
PART_GAP = 44.0  # between parts of the diagram that no cord joins
NEAR = 7.0  # two nets closer than this would be taken for one line
SHORT = 24.0  # an upright shorter than this is a kink rather than a way
LARGE = 400  # boxes; beyond this the order is improved less
