"""Build a 3D Slicer scene file (`.mrml`): nodes, their files, and their parents.

Source: Slicer 5, Libs/MRML/Core: tags are each node's GetNodeTagName, attributes those of its
ReadXMLAttributes; `references` holds "role:id id;" (vtkMRMLNode::ParseReferencesAttribute).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from dvf_ig.io.writing.atomic import write_text

VERSION = "Slicer5.0.3"
"""Oldest version with these nodes: sequences became part of Slicer with 5.0."""
GREY = "vtkMRMLColorTableNodeGrey"


@dataclass(slots=True)
class SlicerScene:
    """Nodes in order of addition; every `add_…` returns the id of its node."""

    _root: ElementTree.Element = field(
        default_factory=lambda: ElementTree.Element("MRML", version=VERSION, userTags="")
    )
    _counts: dict[str, int] = field(default_factory=dict)

    def add_transform(self, name: str, file: str, parent: str | None = None, *, description: str = "") -> str:
        """Add a linear transform read from an ITK file (`write_node_transform`)."""
        storage = self._storage("TransformStorage", "vtkMRMLTransformStorageNode", name, file)
        references = {"storage": storage, "transform": parent}
        return self._add("LinearTransform", "vtkMRMLLinearTransformNode", name, references, description)

    def add_volume(self, name: str, file: str, parent: str | None = None, *, description: str = "") -> str:
        """Add a grey-level image, shown with a window chosen by Slicer."""
        storage = self._storage("VolumeArchetypeStorage", "vtkMRMLVolumeArchetypeStorageNode", name, file)
        display = self._add(
            "VolumeDisplay",
            "vtkMRMLScalarVolumeDisplayNode",
            f"{name} display",
            {"color": GREY},
            autoWindowLevel="1",
            interpolate="1",
        )
        references = {"display": display, "storage": storage, "transform": parent}
        return self._add("Volume", "vtkMRMLScalarVolumeNode", name, references, description)

    def add_segmentation(self, name: str, file: str, *, description: str = "") -> str:
        """Add a segmentation, whose outlines Slicer lays over images (`write_segmentation`)."""
        storage = self._storage("SegmentationStorage", "vtkMRMLSegmentationStorageNode", name, file)
        display = self._add(
            "SegmentationDisplay",
            "vtkMRMLSegmentationDisplayNode",
            f"{name} display",
            {},
            visibility="true",
            visibility2D="true",
        )
        references = {"display": display, "storage": storage}
        return self._add("Segmentation", "vtkMRMLSegmentationNode", name, references, description)

    def add_model(
        self, name: str, file: str, *, visible: bool, color: tuple[float, float, float], description: str = ""
    ) -> str:
        """Add a surface in LPS, translucent, with its contour in the slices."""
        storage = self._storage("ModelStorage", "vtkMRMLModelStorageNode", name, file, coordinateSystem="LPS")
        display = self._add(
            "ModelDisplay",
            "vtkMRMLModelDisplayNode",
            f"{name} display",
            {},
            color=" ".join(map(str, color)),
            opacity="0.4",
            visibility=_flag(visible),
            visibility2D="true",
            sliceIntersectionThickness="2",
            backfaceCulling="false",
        )
        references = {"display": display, "storage": storage}
        return self._add("Model", "vtkMRMLModelNode", name, references, description)

    def add_points(self, name: str, file: str, parent: str | None = None, *, description: str = "") -> str:
        """Add point markups (`write_node_points`)."""
        storage = self._storage("MarkupsJsonStorage", "vtkMRMLMarkupsJsonStorageNode", name, file)
        display = self._add(
            "MarkupsFiducialDisplay",
            "vtkMRMLMarkupsFiducialDisplayNode",
            f"{name} display",
            {},
            visibility="true",
            useGlyphScale="false",
            glyphSize="3",
        )
        references = {"display": display, "storage": storage, "transform": parent}
        return self._add("MarkupsFiducial", "vtkMRMLMarkupsFiducialNode", name, references, description)

    def add_sequence(self, name: str, file: str, *, index: str, unit: str) -> str:
        """Add a sequence of transforms (`.seq.mha`) or volumes (`.seq.nrrd`) over a numeric index."""
        kind = "LinearTransform" if file.endswith(".seq.mha") else "Volume"
        storage = self._storage(f"{kind}SequenceStorage", f"vtkMRML{kind}SequenceStorageNode", name, file)
        return self._add(
            "Sequence",
            "vtkMRMLSequenceNode",
            name,
            {"storage": storage},
            indexName=index,
            indexUnit=unit,
            indexType="numeric",
            numericIndexValueTolerance="0.001",
        )

    def add_browser(self, name: str, pairs: Sequence[tuple[str, str]], *, rate_hz: float) -> str:
        """Add a browser that plays sequences together: pairs of a sequence and the node that shows its item.

        The items of the first sequence set the steps.
        """
        references: dict[str, str | None] = {}
        attributes = {}
        for postfix, (sequence, shown) in enumerate(pairs):
            references |= {f"sequenceNodeRef{postfix}": sequence, f"dataNodeRef{postfix}": shown}
            attributes[f"SynchronizationPropertiesMap{postfix}"] = (
                "playback true recording false overwriteProxyName false saveChanges false "
                "missingItemMode createFromPrevious"
            )
        return self._add(
            "SequenceBrowser",
            "vtkMRMLSequenceBrowserNode",
            name,
            references,
            playbackActive="false",
            playbackRateFps=f"{rate_hz:.3g}",
            playbackItemSkippingEnabled="true",
            playbackLooped="true",
            selectedItemNumber="0",
            recordingActive="false",
            virtualNodePostfixes=" ".join(str(i) for i in range(len(pairs))),
            **attributes,
        )

    def write(self, path: Path) -> None:
        """Write the scene into the folder of the files that it names.

        Raises:
            OutputError: not writable.
        """
        ElementTree.indent(self._root, " ")
        text = ElementTree.tostring(self._root, encoding="unicode")
        write_text(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')

    def _storage(self, tag: str, kind: str, name: str, file: str, **more: str) -> str:
        return self._add(tag, kind, f"{name} storage", {}, fileName=file, useCompression="1", **more)

    def _add(
        self,
        tag: str,
        kind: str,
        name: str,
        references: Mapping[str, str | None],
        description: str = "",
        **attributes: str,
    ) -> str:
        self._counts[kind] = self._counts.get(kind, 0) + 1
        identity = f"{kind}{self._counts[kind]}"
        reference_text = "".join(f"{role}:{one};" for role, one in references.items() if one is not None)
        hidden = tag.endswith(("Storage", "Display"))
        common = {"id": identity, "name": name, "hideFromEditors": _flag(hidden)}
        common |= {"description": description} if description else {}
        common |= {"references": reference_text} if reference_text else {}
        ElementTree.SubElement(self._root, tag, {**common, **attributes})
        return identity


def _flag(value: bool) -> str:
    return "true" if value else "false"
