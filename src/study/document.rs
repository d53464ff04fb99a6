//! The page of all results, from the studies' files.

use std::path::Path;

use anyhow::{Context as _, Result};

use super::{STUDIES, Saved, Study};

const HEAD: &str = "# Results

What the paper claims, measured. `make results` runs every study and writes this page from the numbers that they leave in
`docs/results/`; the verdicts are computed from them. Each study can be run alone with the command beside it; its numbers are
of the tree with which its file there was last written.
";

/// The page from the files in `folder`; a study without one is left out.
pub fn document(folder: &Path) -> Result<String> {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let mut text = HEAD.to_owned();
    for study in STUDIES {
        let path = folder.join(format!("{}.json", study.name));
        if !path.exists() {
            continue;
        }
        let saved = std::fs::read(&path).map_err(anyhow::Error::from).and_then(|b| Ok(serde_json::from_slice(&b)?));
        text += &section(study, &saved.with_context(|| path.display().to_string())?, &name);
    }
    Ok(text)
}

fn section(study: &Study, saved: &Saved, folder: &str) -> String {
    let mut text = format!("\n## {}\n\n> {} ({})\n\n{}\n", study.title, study.claim, study.section, study.method);
    for note in &saved.notes {
        text += &format!("\n{note}\n");
    }
    text += &format!("\n`{}` on {}, {:.0} s\n", saved.command, saved.device, saved.secs);
    for table in &saved.tables {
        text += &format!("\n*{}*\n\n{}", table.caption, table.markdown());
    }
    for figure in &saved.figures {
        text += &format!("\n![{caption}]({folder}/{})\n\n*{caption}*\n", figure.file, caption = figure.caption);
    }
    if !saved.verdicts.is_empty() {
        text.push('\n');
    }
    for verdict in &saved.verdicts {
        let holds = if verdict.holds { "Holds" } else { "Does not hold" };
        text += &format!("- **{holds}:** {} ({})\n", verdict.claim, verdict.evidence);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{Figure, Table, Verdict};

    #[test]
    fn a_section_shows_claim_command_numbers_picture_and_verdict() {
        let study = Study {
            name: "cube",
            title: "The cube",
            claim: "It can be done",
            section: "§1",
            method: "We did it.",
            run: |_| unreachable!(),
        };
        let mut table = Table::new("Distances", "from", &[("cm", 1)]);
        table.row("start", &[2.25]);
        let mut saved = Saved {
            study: "cube".to_owned(),
            command: "effigy study cube --seed 3".to_owned(),
            seed: 3,
            device: "a device".to_owned(),
            secs: 12.4,
            tables: vec![table],
            figures: vec![Figure { file: "cube.jpg".to_owned(), caption: "Left: a cube".to_owned() }],
            verdicts: vec![Verdict::new("done", true, "2.2 of 3")],
            notes: vec!["Forty frames.".to_owned()],
        };
        let text = section(&study, &saved, "results");
        let wanted = [
            "## The cube\n\n> It can be done (§1)\n\nWe did it.\n\nForty frames.\n",
            "`effigy study cube --seed 3` on a device, 12 s\n",
            "*Distances*\n\n| from  |  cm |\n",
            "![Left: a cube](results/cube.jpg)",
            "- **Holds:** done (2.2 of 3)",
        ];
        for want in wanted {
            assert!(text.contains(want), "{want:?} is not in\n{text}");
        }
        saved.verdicts[0].holds = false;
        assert!(section(&study, &saved, "results").contains("- **Does not hold:** done"));
    }

    #[test]
    fn the_committed_page_is_that_of_the_committed_numbers() {
        let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
        let page = std::fs::read_to_string(docs.join("results.md")).unwrap();
        let want = document(&docs.join("results")).unwrap();
        assert!(page == want, "docs/results.md is stale: `effigy study page` writes it anew");
    }
}
