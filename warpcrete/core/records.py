"""Named types of dictionaries whose keys are known only at run time: contents of files, and arguments of scenes."""

from typing import Any, TypeAlias

Record: TypeAlias = dict[str, Any]
"""Contents of a JSON file or of a part of it, by name: numbers, texts, truth values, lists and further records."""
SavedState: TypeAlias = dict[str, Any]
"""State in a checkpoint, by name: numbers, texts, lists, NumPy arrays and further states."""
SceneArguments: TypeAlias = dict[str, Any]
"""Arguments of a scene function by parameter name: numbers, texts, or objects such as a contact law."""
