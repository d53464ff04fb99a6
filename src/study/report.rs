//! What a study found: tables of numbers, pictures, verdicts; and the file that keeps them.

use std::path::Path;

use anyhow::{Context as _, Result};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use serde::{Deserialize, Serialize};

use super::{Context, Study};

/// Pictures in the document stay below this, so that the repository stays small.
const MAX_PICTURE_BYTES: usize = 200_000;

/// A column of numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// With its unit.
    pub name: String,
    /// Decimals shown; the file keeps all.
    pub decimals: usize,
}

/// A line of a table; a place without a number is `None`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub label: String,
    pub values: Vec<Option<f64>>,
}

/// A table of numbers with a label a line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    pub caption: String,
    /// What the labels are.
    pub labels: String,
    pub columns: Vec<Column>,
    pub rows: Vec<Row>,
}

impl Table {
    /// An empty table; `columns` are names with their decimals.
    pub fn new(caption: &str, labels: &str, columns: &[(&str, usize)]) -> Self {
        let columns = columns.iter().map(|&(name, decimals)| Column { name: name.to_owned(), decimals }).collect();
        Self { caption: caption.to_owned(), labels: labels.to_owned(), columns, rows: Vec::new() }
    }

    /// # Panics
    /// When there are not as many values as columns.
    pub fn row(&mut self, label: impl Into<String>, values: &[f64]) {
        self.row_with_gaps(label, values.iter().map(|&v| Some(v)).collect());
    }

    /// As [`Table::row`], with places left empty.
    pub fn row_with_gaps(&mut self, label: impl Into<String>, values: Vec<Option<f64>>) {
        assert_eq!(values.len(), self.columns.len(), "{}: values of a row", self.caption);
        self.rows.push(Row { label: label.into(), values });
    }

    /// As a table of Markdown, which people can read as it is.
    pub fn markdown(&self) -> String {
        let mut lines = vec![
            std::iter::once(self.labels.clone()).chain(self.columns.iter().map(|c| c.name.clone())).collect::<Vec<_>>(),
        ];
        lines.extend(self.rows.iter().map(|row| {
            let cells = row.values.iter().zip(&self.columns).map(|(value, column)| match value {
                Some(value) => format!("{value:.*}", column.decimals),
                None => "–".to_owned(),
            });
            std::iter::once(row.label.clone()).chain(cells).collect()
        }));
        let widths: Vec<usize> = (0..=self.columns.len())
            .map(|k| lines.iter().map(|line| line[k].chars().count()).max().unwrap_or(0).max(3))
            .collect();
        let mut text = String::new();
        for (n, line) in lines.iter().enumerate() {
            for (k, cell) in line.iter().enumerate() {
                let gap = " ".repeat(widths[k] - cell.chars().count());
                text += &if k == 0 { format!("| {cell}{gap} ") } else { format!("| {gap}{cell} ") };
            }
            text += "|\n";
            if n == 0 {
                for (k, width) in widths.iter().enumerate() {
                    text += &if k == 0 {
                        format!("|{}", "-".repeat(width + 2))
                    } else {
                        format!("|{}:", "-".repeat(width + 1))
                    };
                }
                text += "|\n";
            }
        }
        text
    }
}

/// A picture of the document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Beside the study's file.
    pub file: String,
    /// What is where in it.
    pub caption: String,
}

/// What the numbers say about a part of the claim.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// A sentence that is true or not.
    pub claim: String,
    pub holds: bool,
    /// The numbers that decided.
    pub evidence: String,
}

impl Verdict {
    pub fn new(claim: impl Into<String>, holds: bool, evidence: impl Into<String>) -> Self {
        Self { claim: claim.into(), holds, evidence: evidence.into() }
    }
}

/// What a study found in one run.
#[derive(Clone, Debug, Default)]
pub struct Report {
    pub tables: Vec<Table>,
    /// Pictures with their captions.
    pub figures: Vec<(RgbImage, String)>,
    pub verdicts: Vec<Verdict>,
    /// What this run has to add, e.g. sizes: one sentence each.
    pub notes: Vec<String>,
}

/// A study's file: what it found and how to find it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Saved {
    pub study: String,
    pub command: String,
    pub seed: u64,
    pub device: String,
    /// How long the study took.
    pub secs: f64,
    pub tables: Vec<Table>,
    pub figures: Vec<Figure>,
    pub verdicts: Vec<Verdict>,
    pub notes: Vec<String>,
}

impl Report {
    /// Writes the pictures and `<study>.json` into `out`.
    pub fn save(self, study: &Study, context: &Context<'_>, secs: f64, out: &Path) -> Result<Saved> {
        std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
        let mut figures = Vec::new();
        for (n, (picture, caption)) in self.figures.iter().enumerate() {
            let number = if n == 0 { String::new() } else { format!("-{}", n + 1) };
            let file = format!("{}{number}.jpg", study.name);
            std::fs::write(out.join(&file), jpeg(picture)?)?;
            figures.push(Figure { file, caption: caption.clone() });
        }
        let body = if context.body == "default" { String::new() } else { format!(" --body {}", context.body) };
        let saved = Saved {
            study: study.name.to_owned(),
            command: format!("effigy study {} --seed {}{body}", study.name, context.seed),
            seed: context.seed,
            device: context.gpu.info().name.clone(),
            secs,
            tables: self.tables,
            figures,
            verdicts: self.verdicts,
            notes: self.notes,
        };
        let path = out.join(format!("{}.json", study.name));
        std::fs::write(&path, serde_json::to_string_pretty(&saved)? + "\n")
            .with_context(|| path.display().to_string())?;
        Ok(saved)
    }
}

/// The picture in the best quality that stays small.
fn jpeg(picture: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for quality in [92, 85, 75, 60, 40, 20] {
        bytes.clear();
        JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(picture)?;
        if bytes.len() < MAX_PICTURE_BYTES {
            break;
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_aligns_and_rounds() {
        let mut table = Table::new("Errors", "method", &[("error, cm", 2), ("share", 0)]);
        table.row("ours", &[1.2345, 10.0]);
        table.row_with_gaps("theirs", vec![None, Some(7.0)]);
        let want = "| method | error, cm | share |\n|--------|----------:|------:|\n\
                    | ours   |      1.23 |    10 |\n| theirs |         – |     7 |\n";
        assert_eq!(table.markdown(), want);
    }

    #[test]
    fn a_noisy_picture_is_compressed_until_it_is_small() {
        let mut state = 1u32;
        let noise = RgbImage::from_fn(600, 600, |_, _| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            image::Rgb([(state >> 24) as u8, (state >> 16) as u8, 0])
        });
        let bytes = jpeg(&noise).unwrap();
        assert!(bytes.len() < MAX_PICTURE_BYTES, "{} bytes", bytes.len());
        assert_eq!(image::load_from_memory(&bytes).unwrap().width(), 600);
    }
}
