//! Videos of high dynamic range, as phones film them: how FFmpeg brings them to the sRGB that all later parts expect.

/// Luminance of diffuse white in HDR video, cd/m² (ITU-R BT.2408, 75 % HLG): what lies below it is seen alike in both.
const WHITE_NITS: f64 = 203.0;
/// Luminance that HLG's full signal stands for, cd/m² (ITU-R BT.2100).
const PEAK_NITS: f64 = 1000.0;
/// Part of sRGB's light that stays as it is; the highlights up to the peak share the rest.
const KNEE: f64 = 0.9;

/// Filters that the mapping takes. Not every build of FFmpeg has `zscale`.
pub(super) const FILTERS: [&str; 2] = ["zscale", "tonemap"];

/// What a video's header tells of its colours, in FFmpeg's names; empty or `unknown` where it does not.
#[derive(Clone, Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(super) struct Colours {
    color_transfer: String,
    color_primaries: String,
    color_space: String,
}

impl Colours {
    /// Whether the video is HLG or PQ.
    pub fn are_hdr(&self) -> bool {
        matches!(self.color_transfer.as_str(), "arib-std-b67" | "smpte2084")
    }

    /// The chain of filters from this HDR video to full-range sRGB: light in units of diffuse white, BT.709's primaries,
    /// highlights compressed. Tags that are missing are taken for BT.2020's.
    pub fn to_srgb(&self) -> String {
        let known = |tag: &str| !matches!(tag, "" | "unknown" | "unspecified" | "reserved");
        let primaries = if known(&self.color_primaries) { "" } else { "setparams=color_primaries=bt2020," };
        let matrix = if known(&self.color_space) { "" } else { "setparams=colorspace=bt2020nc," };
        let peak = PEAK_NITS / WHITE_NITS;
        // Without chroma subsampling first: `zscale` refuses subsampled pictures with odd sides. Its approximate gamma would raise
        // each channel of HLG by itself, where BT.2100 raises the luminance.
        format!(
            "format=yuv444p10le|gbrp10le,{primaries}{matrix}zscale=t=linear:npl={WHITE_NITS}:agamma=0,\
             format=gbrpf32le,zscale=p=bt709,tonemap=mobius:param={KNEE}:desat=0:peak={peak},\
             zscale=t=iec61966-2-1:m=gbr:r=pc,format=gbrp"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn colours(transfer: &str, primaries: &str, space: &str) -> Colours {
        Colours { color_transfer: transfer.into(), color_primaries: primaries.into(), color_space: space.into() }
    }

    #[test]
    fn hlg_and_pq_are_hdr() {
        assert!(colours("arib-std-b67", "bt2020", "bt2020nc").are_hdr());
        assert!(colours("smpte2084", "", "").are_hdr());
        assert!(!colours("bt709", "bt709", "bt709").are_hdr() && !Colours::default().are_hdr());
    }

    #[test]
    fn tags_count_where_there_are_any() {
        let tagged = colours("smpte2084", "smpte432", "bt2020nc").to_srgb();
        assert!(!tagged.contains("setparams"), "{tagged}");
        let bare = colours("arib-std-b67", "unknown", "").to_srgb();
        assert!(bare.contains("color_primaries=bt2020,setparams=colorspace=bt2020nc,"), "{bare}");
    }
}
